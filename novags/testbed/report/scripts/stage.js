// Two pictures, one over the other, with a border between them; they zoom and move in step.
novags.stage = {
  zoom: 1, x: 0.5, y: 0.5,  // the middle of what is shown, as shares of the picture
  at: 50,  // % of the width that shows the left picture
  pixel: null,
  fingers: new Map(),

  get box() { return novags.byId("compare"); },

  draw() {
    const box = this.box, half = 0.5 / this.zoom;
    this.x = Math.min(1 - half, Math.max(half, this.x));
    this.y = Math.min(1 - half, Math.max(half, this.y));
    const { width, height } = this.size();
    box.style.setProperty("--zoom", this.zoom);
    box.style.setProperty("--x", `${width * (0.5 - this.x * this.zoom)}px`);
    box.style.setProperty("--y", `${height * (0.5 - this.y * this.zoom)}px`);
    box.style.setProperty("--at", `${this.at}%`);
    box.classList.toggle("zoomed", this.zoom > 1);
    for (const image of box.querySelectorAll(".layer img")) {
      image.classList.toggle("pixels", image.naturalWidth < 480 || this.zoom * width >= 2 * image.naturalWidth);
    }
    novags.byId("slider").value = this.at;
    this.mark();
  },
  size() {
    return { width: this.box.clientWidth, height: this.box.clientHeight };
  },
  // Where a point of the screen lies in the picture, as shares of it.
  place(clientX, clientY) {
    const frame = this.box.getBoundingClientRect(), { width, height } = this.size();
    return {
      x: this.x + ((clientX - frame.left - this.box.clientLeft) / width - 0.5) / this.zoom,
      y: this.y + ((clientY - frame.top - this.box.clientTop) / height - 0.5) / this.zoom,
    };
  },
  // Zoom so that a place of the picture stays where it is on the screen.
  zoomTo(zoom, place) {
    const to = Math.min(64, Math.max(1, zoom)), share = this.zoom / to;
    this.x = place.x + (this.x - place.x) * share;
    this.y = place.y + (this.y - place.y) * share;
    this.zoom = to;
    this.draw();
    this.keep();
  },
  middle() {
    if (this.zoom === 1 && this.pixel) return { x: (this.pixel.x + 0.5) / this.pixels.width, y: (this.pixel.y + 0.5) / this.pixels.height };
    return { x: this.x, y: this.y };
  },
  border(clientX) {
    const frame = this.box.getBoundingClientRect();
    this.at = Math.min(100, Math.max(0, (100 * (clientX - frame.left)) / frame.width));
    this.draw();
    this.keep();
  },

  probe(place, kept) {
    const { width, height } = this.pixels, pin = (share, count) => Math.min(count - 1, Math.max(0, Math.floor(share * count)));
    this.pixel = { x: pin(place.x, width), y: pin(place.y, height) };
    this.mark();
    novags.look.probe();
    if (kept) this.keep();
  },
  // The pixel, where the view that is shown now does not have it.
  forget() {
    const { pixel, pixels } = this;
    if (!pixel || (pixel.x < pixels.width && pixel.y < pixels.height)) return;
    this.pixel = null;
    novags.probe.clear();
  },
  step(x, y) {
    const { width, height } = this.pixels, now = this.pixel ?? { x: width >> 1, y: height >> 1 };
    this.probe({ x: (now.x + x + 0.5) / width, y: (now.y + y + 0.5) / height }, true);
    const half = 0.45 / this.zoom, px = (this.pixel.x + 0.5) / width, py = (this.pixel.y + 0.5) / height;
    this.x = Math.min(px + half, Math.max(px - half, this.x));  // what is probed stays in sight
    this.y = Math.min(py + half, Math.max(py - half, this.y));
    this.draw();
  },
  mark() {
    const cross = novags.byId("cross");
    cross.hidden = !this.pixel;
    if (!this.pixel) return;
    const { width, height } = this.size(), cell = (this.zoom * width) / this.pixels.width;
    cross.style.width = cross.style.height = `${cell}px`;
    cross.style.left = `${width * (0.5 + ((this.pixel.x + 0.5) / this.pixels.width - this.x) * this.zoom)}px`;
    cross.style.top = `${height * (0.5 + ((this.pixel.y + 0.5) / this.pixels.height - this.y) * this.zoom)}px`;
  },

  keep() {
    const { state } = novags, round = (value) => +value.toFixed(4);
    state.set("border", this.at === 50 ? "" : round(this.at));
    state.set("zoom", this.zoom === 1 ? "" : [this.zoom, this.x, this.y].map(round).join(","));
    state.set("pixel", this.pixel ? `${this.pixel.x},${this.pixel.y}` : "");
  },
  restore() {
    const numbers = (key) => novags.state.get(key).split(",").map(Number);
    const [zoom, x, y] = numbers("zoom"), [px, py] = numbers("pixel"), at = numbers("border")[0];
    [this.zoom, this.x, this.y] = zoom >= 1 && zoom <= 64 && x >= 0 && y >= 0 ? [zoom, x, y] : [1, 0.5, 0.5];
    this.at = novags.state.get("border") !== "" && at >= 0 && at <= 100 ? at : 50;
    const inside = px >= 0 && py >= 0 && px < this.pixels.width && py < this.pixels.height;
    this.pixel = inside && novags.state.get("pixel") !== "" ? { x: px, y: py } : null;
    this.draw();
    if (this.pixel) novags.look.probe();
  },

  start() {
    const box = this.box, slider = novags.byId("slider"), press = (id, act) => novags.byId(id).addEventListener("click", act);
    slider.addEventListener("input", () => {
      this.at = +slider.value;
      this.draw();
      this.keep();
    });
    press("in", () => this.zoomTo(this.zoom * 2, this.middle()));
    press("out", () => this.zoomTo(this.zoom / 2, this.middle()));
    press("whole", () => this.zoomTo(1, this.middle()));
    box.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return;  // a plain wheel scrolls the page
      event.preventDefault();
      this.zoomTo(this.zoom * 2 ** (-event.deltaY / 240), this.place(event.clientX, event.clientY));
    }, { passive: false });
    box.addEventListener("keydown", (event) => this.key(event));
    for (const kind of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) box.addEventListener(kind, (event) => this[kind](event));
    new ResizeObserver(() => this.draw()).observe(box);
  },
  key(event) {
    const far = event.shiftKey ? 10 : 1;
    const acts = {
      ArrowLeft: () => this.step(-far, 0), ArrowRight: () => this.step(far, 0), ArrowUp: () => this.step(0, -far), ArrowDown: () => this.step(0, far),
      "+": () => this.zoomTo(this.zoom * 2, this.middle()), "=": () => this.zoomTo(this.zoom * 2, this.middle()),
      "-": () => this.zoomTo(this.zoom / 2, this.middle()), 0: () => this.zoomTo(1, this.middle()),
    };
    if (!acts[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    acts[event.key]();
  },

  pointerdown(event) {
    if (event.button) return;
    this.box.setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, event);
    this.moved = this.fingers.size > 1;
    this.drags = event.target === novags.byId("border") || this.zoom === 1 ? "border" : "picture";
  },
  pointermove(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) {
      if (event.pointerType === "mouse") this.probe(this.place(event.clientX, event.clientY), false);
      return;
    }
    const start = before.start ?? before;
    if (Math.hypot(event.clientX - start.clientX, event.clientY - start.clientY) > 4) this.moved = true;
    if (!this.moved) return;
    if (this.fingers.size === 2) this.pinch(event, before);
    else if (this.drags === "border") this.border(event.clientX);
    else this.drag(event, before);
    this.fingers.set(event.pointerId, { clientX: event.clientX, clientY: event.clientY, start });
  },
  drag(event, before) {
    const { width, height } = this.size();
    this.x -= (event.clientX - before.clientX) / width / this.zoom;
    this.y -= (event.clientY - before.clientY) / height / this.zoom;
    this.draw();
    this.keep();
  },
  pinch(event, before) {
    const [id] = [...this.fingers.keys()].filter((other) => other !== event.pointerId), other = this.fingers.get(id);
    const apart = (a) => Math.hypot(a.clientX - other.clientX, a.clientY - other.clientY) || 1;
    const middle = this.place((event.clientX + other.clientX) / 2, (event.clientY + other.clientY) / 2);
    this.zoomTo((this.zoom * apart(event)) / apart(before), middle);
  },
  pointerup(event) {
    if (this.fingers.delete(event.pointerId) && !this.moved) this.probe(this.place(event.clientX, event.clientY), true);
  },
  pointercancel(event) {
    this.fingers.delete(event.pointerId);
  },
};

// Which view is shown, which two of its pictures are compared, and what lies under the probe.
novags.look = {
  grids: [...document.querySelectorAll(".grid[data-view]")],

  get grid() { return this.grids[novags.byId("view").value]; },
  figures() { return [...this.grid.querySelectorAll("figure")]; },
  figure(key) { return this.figures().find((figure) => figure.dataset.key === key); },
  label: (figure) => figure.querySelector("img").dataset.label,

  // Keep the choice from view to view where the new view has that picture.
  fill(side, wanted) {
    const select = novags.byId(side), keys = this.figures().map((figure) => figure.dataset.key);
    const chosen = [wanted, select.value, ...(novags.data[side] ?? [])].find((key) => keys.includes(key)) ?? keys[0];
    select.replaceChildren(...this.figures().map((figure) => new Option(this.label(figure), figure.dataset.key, false, figure.dataset.key === chosen)));
  },
  place(side) {
    const figure = this.figure(novags.byId(side).value), image = novags.byId(`${side}-image`), source = figure.querySelector("img");
    image.onload = () => {
      novags.stage.draw();
      if (novags.stage.pixel) this.probe();
    };
    image.onerror = () => {
      image.onerror = null;
      novags.byId("lost").hidden = false;
      image.src = source.src;  // the thumbnail
    };
    image.src = source.dataset.full ?? source.src;
    image.alt = source.alt;
    novags.byId(`${side}-tag`).textContent = this.label(figure);
  },
  show() {
    for (const side of ["left", "right"]) this.place(side);
    for (const figure of this.figures()) {
      const chosen = ["left", "right"].some((side) => novags.byId(side).value === figure.dataset.key);
      figure.classList.toggle("chosen", chosen);
      figure.querySelector("img").setAttribute("aria-pressed", chosen);
    }
    if (novags.stage.pixel) this.probe();
  },
  fetch(grid) {
    if ("ready" in grid.dataset) return;
    novags.unpack(grid);
    for (const figure of grid.querySelectorAll("figure")) this.listen(figure);
    grid.classList.toggle("pixels", +grid.querySelector("img").getAttribute("width") < 480);
    grid.dataset.ready = "";
  },
  listen(figure) {
    const image = figure.querySelector("img"), side = (event) => (event.shiftKey ? "left" : "right");
    image.tabIndex = 0;
    image.setAttribute("role", "button");
    image.addEventListener("click", (event) => this.choose(figure, side(event)));
    image.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      this.choose(figure, side(event));
    });
  },
  change(left, right) {
    this.fetch(this.grid);
    this.grids.forEach((grid) => grid.classList.toggle("shown", grid === this.grid));
    this.fill("left", left);
    this.fill("right", right);
    const picture = this.figures()[0].querySelector("img");
    novags.stage.pixels = { width: +picture.getAttribute("width"), height: +picture.getAttribute("height") };
    const aspect = novags.stage.pixels.width / novags.stage.pixels.height, box = novags.stage.box;
    box.style.aspectRatio = aspect;
    box.style.width = `${Math.round(560 * Math.min(1, aspect))}px`;  // at most 560 px high
    novags.stage.forget();
    this.show();
    novags.stage.draw();
  },
  keep() {
    const { state } = novags, value = (id) => novags.byId(id).value;
    state.set("view", this.grid.dataset.name);
    state.set("left", value("left"));
    state.set("right", value("right"));
    if (!novags.stage.pixel) state.set("pixel", "");
  },
  choose(figure, side) {
    novags.byId(side).value = figure.dataset.key;
    this.show();
    this.keep();
    this.reveal();
  },
  // A view by its name, with that picture on the right.
  open(name, key) {
    novags.byId("view").value = Math.max(0, this.grids.findIndex((grid) => grid.dataset.name === name));
    this.change("", key);
    this.keep();
    this.reveal();
  },
  reveal() {
    const frame = novags.stage.box.getBoundingClientRect();
    if (frame.bottom < 80 || frame.top > innerHeight - 80) novags.stage.box.scrollIntoView({ block: "center", behavior: "smooth" });
  },

  // The codes of a picture as the page shows it, where they are those of the file.
  codes(side, x, y) {
    const image = novags.byId(`${side}-image`), source = this.figure(novags.byId(side).value).querySelector("img");
    if (!("exact" in source.dataset) || !image.complete || image.naturalWidth !== novags.stage.pixels.width) return null;
    const canvas = this.canvas ??= document.createElement("canvas");
    canvas.width = canvas.height = 1;
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(image, -x, -y);
    return [...context.getImageData(0, 0, 1, 1).data.slice(0, 3)];
  },
  probe() {
    const { x, y } = novags.stage.pixel;
    const label = (side) => this.label(this.figure(novags.byId(side).value));
    const pictures = ["left", "right"].map((side) => ({ label: label(side), codes: this.codes(side, x, y) }));
    novags.probe.show(this.grid, x, y, pictures);
  },
};

// The pictures that the page begins with: the grid of that view has no others of its own, and a click compares them.
novags.film = {
  figures: [...document.querySelectorAll(".film figure")],

  start() {
    for (const figure of this.figures) {
      const image = figure.querySelector("img"), link = document.createElement("a"), small = image.src;
      const grid = novags.look.grids.find((other) => other.dataset.name === figure.dataset.of);
      link.href = "#look";
      image.before(link);
      link.append(image);
      link.addEventListener("click", (event) => {
        event.preventDefault();
        novags.look.open(figure.dataset.of, figure.dataset.film);
      });
      this.same(grid, figure.dataset.film).src = small;
      if (!image.dataset.full) continue;
      image.onerror = () => {
        image.onerror = null;
        image.src = small;
      };
      image.src = image.dataset.full;
    }
  },
  same(grid, key) {
    novags.look.fetch(grid);
    return grid.querySelector(`figure[data-key="${CSS.escape(key)}"] img`);
  },
};

if (novags.look.grids.length) novags.parts.push({
  start() {
    const { look } = novags;
    novags.film.start();
    novags.byId("stage").hidden = false;
    novags.byId("view").addEventListener("change", () => {
      look.change();
      look.keep();
    });
    for (const side of ["left", "right"]) novags.byId(side).addEventListener("change", () => {
      look.show();
      look.keep();
    });
    look.change();
    novags.stage.start();
  },
  restore() {
    const { look, state } = novags, wanted = look.grids.findIndex((grid) => grid.dataset.name === state.get("view"));
    novags.byId("view").value = Math.max(0, wanted);
    for (const side of ["left", "right"]) novags.byId(side).value = "";
    look.change(state.get("left"), state.get("right"));
    novags.stage.restore();
  },
});

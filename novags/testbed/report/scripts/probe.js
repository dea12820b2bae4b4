// What is known of a pixel of the dark exposure: digital numbers, electrons, their noise, linear light.
novags.probe = {
  views: new Map(),  // planes by name, or a promise of them
  waiting: new Map(),

  // Beside the page lie scripts that call this.
  receive(name, text) {
    this.waiting.get(name)?.(text);
  },
  async text(grid, name) {
    const inside = grid.querySelector(`script[data-for="${CSS.escape(name)}"]`);
    if (inside) return inside.textContent;
    const script = document.createElement("script");
    const found = new Promise((done, failed) => {
      this.waiting.set(name, done);
      script.onerror = () => failed(new Error(`${decodeURIComponent(grid.dataset.file)} is not beside this page`));
    });
    script.src = grid.dataset.file;
    document.head.append(script);
    return found;
  },
  planes(grid) {
    const name = `probe-${grid.dataset.name}`;
    if (!this.views.has(name)) this.views.set(name, this.unpacked(grid, name));
    return this.views.get(name);
  },
  async unpacked(grid, name) {
    const header = JSON.parse(grid.dataset.probe);
    const packed = Uint8Array.from(atob(await this.text(grid, name)), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const planes = {};
    let start = 0;
    for (const plane of header.planes) {
      const count = plane.channels * header.width * header.height;
      planes[plane.name] = { ...plane, low: bytes.subarray(start, start + count), high: bytes.subarray(start + count, start + 2 * count) };
      start += 2 * count;
    }
    return { header, planes };
  },
  half(code) {
    const sign = code & 0x8000 ? -1 : 1, exponent = (code >> 10) & 31, fraction = code & 1023;
    if (exponent === 31) return fraction ? NaN : sign * Infinity;
    return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024));
  },

  // Values of a plane at a pixel: red, green, blue; of a mosaic only the channel of its filter.
  at({ header, planes }, name, x, y) {
    const plane = planes[name];
    if (!plane) return null;
    const values = [null, null, null];
    for (let c = 0; c < plane.channels; c++) {
      const place = (c * header.height + y) * header.width + x;
      const code = plane.low[place] | (plane.high[place] << 8);
      const value = plane.whole ? code : plane.scale * this.half(code);
      if (plane.channels === 3) values[c] = value;
      else if (header.cfa) values["RGB".indexOf(header.cfa[(y % 2) * 2 + (x % 2)])] = value;
      else values.fill(value);
    }
    return values;
  },

  rows(found, x, y) {
    const { header } = found, { gain, black } = header, map = (values, change) => values && values.map((v, c) => (v === null ? null : change(v, c)));
    const dn = this.at(found, "dn", x, y), mean = this.at(found, "mean", x, y), noise = this.at(found, "noise", x, y) ?? (header.floor === null ? null : map(mean, (v) => Math.sqrt(v + header.floor)));
    const light = header.per_dn && ((v, c) => (v - black) * header.per_dn[c]);
    const mean_dn = map(mean, (v) => black + gain * v);
    return [
      ["Digital number, DN", dn, 0],
      ["True mean, DN", mean_dn, 2],
      ["Electrons, measured", gain && map(dn, (v) => (v - black) / gain), 2],
      ["Electrons, true mean", mean, 2],
      ["True noise, electrons", noise, 2],
      ["True noise, DN", map(noise, (v) => gain * v), 2],
      ["Signal to noise", mean && noise && mean.map((v, c) => (v === null ? null : v / noise[c])), 2],
      ["Linear light, measured", light ? map(dn, light) : this.at(found, "linear", x, y), 5],
      ["Linear light, noise-free", this.at(found, "linear_mean", x, y) ?? (light ? map(mean_dn, light) : null), 5],
    ].filter(([, values]) => values);
  },

  clear() {
    this.latest = "";
    novags.byId("probe").replaceChildren();
  },
  async show(grid, x, y, pictures) {
    const box = novags.byId("probe");
    this.latest = `${grid.dataset.name} ${x} ${y}`;
    const mine = this.latest;
    let rows = [], lost = "";
    if (grid.dataset.probe) {
      try { rows = this.rows(await this.planes(grid), x, y); } catch (error) { lost = error.message; }
    }
    if (mine !== this.latest) return;  // the pointer has moved on
    const shown = pictures.map(({ label, codes }) => [`${label}, 8-bit code`, codes, 0]).filter(([, codes]) => codes);
    const cell = (value, digits) => `<td class="num" data-value="${value ?? ""}">${value === null ? "" : value.toFixed(digits)}</td>`;
    box.innerHTML = `<table><thead><tr><th scope="col">Pixel <span data-pixel>${x}, ${y}</span></th><th scope="col" class="num">Red</th><th scope="col" class="num">Green</th><th scope="col" class="num">Blue</th></tr></thead><tbody></tbody></table>`;
    for (const [label, values, digits] of [...rows, ...shown]) {
      const row = box.querySelector("tbody").insertRow();
      row.innerHTML = `<th scope="row"></th>${values.map((value) => cell(value, digits)).join("")}`;
      row.cells[0].textContent = label;
    }
    if (lost) box.append(Object.assign(document.createElement("p"), { className: "muted", textContent: `The numbers of the exposure cannot be read: ${lost}.` }));
  },
};

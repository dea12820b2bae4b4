// The table of single views for each score, and a strip with a dot for each view.
novags.views = {
  show(kind, key) {
    const { scores } = novags.data.views[kind], score = scores[key];
    const table = document.querySelector(`table[data-name="views-${kind}"]`);
    const write = (row, values) => values.forEach((value, k) => {
      const cell = row.cells[k + 1], number = typeof value === "number";
      cell.dataset.value = value ?? "";
      cell.textContent = number ? value.toFixed(score.digits) : value ?? (row.dataset.spread ? "" : "unavailable");
    });
    for (const row of novags.rows.of(table)) write(row, score.values[novags.data.views[kind].views.indexOf(row.dataset.view)]);
    for (const row of table.tFoot.rows) write(row, score.spread[row.dataset.spread]);
    for (const head of [...table.tHead.rows[0].cells].slice(1)) head.dataset.better = score.more ? "more" : "less";
    this.strip(kind, score);
  },

  svg(kind, attributes) {
    const made = Object.assign(document.createElement("div"), { innerHTML: `<svg><${kind}/></svg>` }).firstChild.firstChild;
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  },

  strip(kind, score) {
    const box = document.querySelector(`[data-strip="${kind}"]`), { methods, views } = novags.data.views[kind];
    const known = score.values.flat().filter((value) => typeof value === "number");
    box.replaceChildren();
    if (!known.length) return;
    const svg = this.svg, width = Math.max(280, box.clientWidth), left = Math.min(0.5 * width, 24 + 7 * Math.max(...methods.map((name) => name.length + 1))), line = 26, height = methods.length * line + 34;
    let low = Math.min(...known), high = Math.max(...known);
    const pad = 0.04 * (high - low) || 0.5;
    [low, high] = [low - pad, high + pad];
    const x = (value) => left + ((width - left - 20) * (value - low)) / (high - low);
    const unit = score.unit ? ` ${score.unit}` : "";
    const drawing = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${score.heading} of every held-out view, a line for each method` });
    const text = (content, attributes) => Object.assign(svg("text", attributes), { textContent: content });
    methods.forEach((name, m) => {
      const y = m * line + 16, look = novags.data.looks[name];
      drawing.append(text(name + (look.competes ? "" : "†"), { class: "name", x: left - 14, y: y + 4, "text-anchor": "end" }));
      drawing.append(svg("line", { class: "rule", x1: left, x2: width - 20, y1: y, y2: y }));
      score.values.forEach((row, v) => {
        if (typeof row[m] !== "number") return;
        const dot = svg("circle", { class: look.key, cx: x(row[m]), cy: y, r: 5 });
        dot.append(Object.assign(svg("title", {}), { textContent: `${name}, view ${views[v]}: ${row[m].toFixed(score.digits)}${unit}` }));
        drawing.append(dot);
      });
      const mean = score.spread.mean[m];
      if (typeof mean === "number") drawing.append(svg("line", { class: "mean", x1: x(mean), x2: x(mean), y1: y - 8, y2: y + 8 }));
    });
    const ticks = this.ticks(low, high);
    ticks.forEach((value, k) => drawing.append(text(`${+value.toPrecision(12)}${k === ticks.length - 1 ? unit : ""}`, { class: "tick", x: x(value), y: height - 6, "text-anchor": "middle" })));
    box.append(drawing);
    for (const label of drawing.querySelectorAll("text.name")) this.fit(label, left - 14);
  },

  // Round values, as the other charts have them: steps of 1, 2 or 5.
  ticks(low, high) {
    const power = 10 ** Math.floor(Math.log10((high - low) / 5)), rough = (high - low) / 5 / power;
    const step = power * [1, 2, 5, 10].find((factor) => factor >= rough - 1e-9), first = Math.ceil(low / step - 1e-9);
    return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, k) => (first + k) * step);
  },

  // Names of variants differ at their beginnings or at their ends: what does not fit is cut out of the middle.
  fit(label, space) {
    const whole = label.textContent, long = label.getComputedTextLength();
    if (long <= space) return;
    const half = Math.max(1, Math.floor((0.5 * whole.length * space) / long) - 1);
    label.textContent = `${whole.slice(0, half)}…${whole.slice(-half)}`;
    label.append(Object.assign(this.svg("title", {}), { textContent: whole }));
  },
};

novags.parts.push({
  start() {
    for (const select of document.querySelectorAll("select[data-views]")) {
      const kind = select.dataset.views, again = () => novags.views.strip(kind, novags.data.views[kind].scores[select.value]);
      new ResizeObserver(again).observe(document.querySelector(`[data-strip="${kind}"]`));
      select.addEventListener("change", () => {
        novags.state.set(`score.${select.dataset.views}`, select.selectedIndex ? select.value : "");
        novags.views.show(select.dataset.views, select.value);
      });
    }
  },
  restore() {
    for (const select of document.querySelectorAll("select[data-views]")) {
      const wanted = novags.state.get(`score.${select.dataset.views}`);
      if ([...select.options].some((option) => option.value === wanted)) select.value = wanted;
      else select.selectedIndex = 0;
      novags.views.show(select.dataset.views, select.value);
    }
  },
});

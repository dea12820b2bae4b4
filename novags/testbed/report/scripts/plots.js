// Charts show the values where one points at them; with the focus on a chart, the arrow keys walk along it.
novags.plots = {
  svg(kind, attributes) {
    if (!novags.plots.space) {
      const box = document.createElement("div");
      box.innerHTML = "<svg></svg>";
      novags.plots.space = box.firstChild.namespaceURI;
    }
    const made = document.createElementNS(novags.plots.space, kind);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  },

  show(chart, plot, x) {
    this.hide(chart);
    const places = plot.lines.flatMap((line) => line.points.map((point) => point[0]));
    const at = places.reduce((best, place) => (Math.abs(place - x) < Math.abs(best - x) ? place : best), places[0]);
    const near = plot.lines.flatMap((line) => {
      const point = line.points.reduce((best, other) => (Math.abs(other[0] - at) < Math.abs(best[0] - at) ? other : best), line.points[0]);
      return point && Math.abs(point[0] - at) <= plot.step ? [{ line, point }] : [];
    });
    const height = chart.viewBox.baseVal.height, group = this.svg("g", { class: "plot-shown" });
    group.append(this.svg("line", { class: "plot-rule", x1: at, x2: at, y1: 14, y2: height - 46 }));
    for (const { line, point } of near) group.append(this.svg("circle", { class: `plot-point ${line.key}`, cx: point[0], cy: point[1], r: 4 }));
    chart.append(group);
    this.note(chart, plot, near, at);
    plot.at = at;
  },
  note(chart, plot, near, at) {
    const note = chart.parentElement.querySelector(".plot-note"), first = near.find(({ point }) => point[0] === at);
    note.replaceChildren(Object.assign(document.createElement("strong"), { textContent: `${first.point[2]} ${plot.x}` }));
    for (const { line, point } of near.sort((a, b) => a.point[1] - b.point[1])) {
      const row = document.createElement("div"), dot = document.createElement("span");
      dot.className = `dot ${line.key}`;
      row.append(dot, `${line.name} ${point[3]}`);
      note.append(row);
    }
    note.hidden = false;
    const share = at / chart.viewBox.baseVal.width;
    note.style.left = share < 0.5 ? `${100 * share + 3}%` : "auto";
    note.style.right = share < 0.5 ? "auto" : `${100 * (1 - share) + 3}%`;
  },
  hide(chart) {
    chart.querySelector(".plot-shown")?.remove();
    chart.parentElement.querySelector(".plot-note").hidden = true;
  },
  walk(chart, plot, way) {
    const places = [...new Set(plot.lines.flatMap((line) => line.points.map((point) => point[0])))].sort((a, b) => a - b);
    const now = plot.at === undefined ? -1 : places.indexOf(plot.at);
    this.show(chart, plot, places[Math.min(places.length - 1, Math.max(0, now + way))]);
  },
};

novags.parts.push({
  adopt(root) {
    for (const chart of root.querySelectorAll("svg[data-plot]")) {
      const plot = JSON.parse(chart.dataset.plot), box = document.createElement("div");
      box.className = "plot";
      box.innerHTML = '<div class="plot-note" role="status" hidden></div>';
      chart.before(box);
      box.prepend(chart);
      const gaps = plot.lines.flatMap((line) => line.points.slice(1).map((point, k) => point[0] - line.points[k][0]));
      plot.step = Math.max(1, Math.min(...gaps, 20) * 0.75);  // lines without a point so near have none there
      chart.setAttribute("tabindex", "0");
      const point = (event) => {
        const box = chart.getBoundingClientRect();
        novags.plots.show(chart, plot, ((event.clientX - box.left) / box.width) * chart.viewBox.baseVal.width);
      };
      chart.addEventListener("pointermove", point);
      chart.addEventListener("pointerdown", point);
      chart.addEventListener("pointerleave", () => novags.plots.hide(chart));
      chart.addEventListener("blur", () => novags.plots.hide(chart));
      chart.addEventListener("keydown", (event) => {
        const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
        if (!way) return;
        event.preventDefault();
        novags.plots.walk(chart, plot, way);
      });
    }
  },
  restore() {},
});

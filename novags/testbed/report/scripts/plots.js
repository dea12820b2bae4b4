// Charts show the values where one points at them; with the focus on a chart, the arrow keys walk along it.
novags.plots = {
  nearest: (points, x) => points.reduce((best, other) => (Math.abs(other[0] - x) < Math.abs(best[0] - x) ? other : best), [Infinity]),

  show(chart, plot, x) {
    this.hide(chart);
    const [at, , said] = this.nearest(plot.lines.flatMap((line) => line.points), x);
    const near = plot.lines.map((line) => ({ line, point: this.nearest(line.points, at) }));
    const shown = near.filter(({ point }) => Math.abs(point[0] - at) <= plot.step).sort((a, b) => a.point[1] - b.point[1]);
    const points = shown.map(({ line, point }) => `<circle class="plot-point ${line.key}" cx="${point[0]}" cy="${point[1]}" r="4"/>`);
    const rule = `<line class="plot-rule" x1="${at}" x2="${at}" y1="${plot.top}" y2="${plot.floor}"/>`;
    chart.insertAdjacentHTML("beforeend", `<g class="plot-shown">${rule}${points.join("")}</g>`);
    const note = chart.nextElementSibling, share = at / chart.viewBox.baseVal.width;
    note.innerHTML = "<strong></strong>" + shown.map(({ line }) => `<div><span class="dot ${line.key}"></span></div>`).join("");
    note.firstChild.append(`${said} ${plot.x}`);
    shown.forEach(({ line, point }, k) => note.children[k + 1].append(`${line.name} ${point[3]}`));
    note.hidden = false;
    note.style.left = share < 0.5 ? `${100 * share + 3}%` : "auto";
    note.style.right = share < 0.5 ? "auto" : `${100 * (1 - share) + 3}%`;
    plot.at = at;
  },
  hide(chart) {
    chart.querySelector(".plot-shown")?.remove();
    chart.nextElementSibling.hidden = true;
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

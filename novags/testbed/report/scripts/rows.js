// Long tables: every row counts, when they are sorted, narrowed or saved, but only the first hundred that are wanted are
// laid out. More follow as one scrolls to the end, and all of them for the printer.
novags.rows = {
  STEP: 100,
  long: new Map(),

  of(table) {
    return this.long.get(table)?.rows ?? [...table.tBodies[0].rows];
  },
  // Put rows into this order.
  order(table, rows) {
    const found = this.long.get(table);
    if (!found) return table.tBodies[0].append(...rows);
    found.rows = rows;
    this.show(table);
  },
  // Lay out what is wanted, after some rows were hidden or shown: the first of them, or up to the `limit`-th.
  show(table, limit = this.STEP) {
    const found = this.long.get(table);
    if (found) {
      const wanted = found.rows.filter((row) => !row.hidden);
      found.limit = Math.min(limit, wanted.length);
      table.tBodies[0].replaceChildren(...wanted.slice(0, limit));
      found.more.hidden = limit >= wanted.length;
      found.more.textContent = `${found.limit} of ${wanted.length} rows: show more`;
    }
    novags.cells.reach(table);
  },
  adopt(table) {
    const rest = table.parentElement.querySelector(":scope > script.rest"), made = document.createElement("template");
    if (rest) made.innerHTML = `<table><tbody>${rest.textContent}</tbody></table>`;
    const later = made.content.querySelectorAll("tr"), rows = [...table.tBodies[0].rows, ...later];
    rest?.remove();
    if (rows.length <= this.STEP) return table.tBodies[0].append(...later);
    const more = document.createElement("button");
    more.type = "button";
    more.className = "further";
    table.parentElement.after(more);
    this.long.set(table, { rows, more, limit: this.STEP });
    more.addEventListener("click", () => this.show(table, this.long.get(table).limit + this.STEP));
    new IntersectionObserver(([seen]) => seen.isIntersecting && more.click(), { rootMargin: "400px" }).observe(more);
    this.show(table);
  },
};

novags.parts.push({
  start() {
    addEventListener("beforeprint", () => novags.rows.long.forEach((_, table) => novags.rows.show(table, Infinity)));
    addEventListener("afterprint", () => novags.rows.long.forEach((_, table) => novags.rows.show(table)));
  },
  adopt(root) {
    for (const table of root.querySelectorAll("table[data-name]")) novags.rows.adopt(table);
  },
});

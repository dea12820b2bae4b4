// A number of a table says how it was made: a click, or Enter, shows the command. Arrow keys move between numbers.
// Where a row has pictures, they are a click away: on what stands in front of the numbers, or on a button at the command.
novags.cells = {
  stops: new Map(),  // the number of each table that the Tab key goes to

  stop(table, cell) {
    const before = this.stops.get(table);
    if (before) before.tabIndex = -1;
    if (cell) cell.tabIndex = 0;
    this.stops.set(table, cell);
  },
  isShown: (cell) => getComputedStyle(cell).display !== "none",  // columns that say the same in every row are not
  first(table) {
    return [...table.tBodies[0].querySelectorAll("tr[data-command]:not([hidden]) td.num")].find(this.isShown);
  },
  // After rows were hidden or put in another order: one that is shown.
  reach(table) {
    const now = this.stops.get(table);
    if (this.stops.has(table) && (!now?.isConnected || now.parentElement.hidden)) this.stop(table, this.first(table));
  },
  name: (row) => [novags.tables.text(row.querySelector("th")), row.dataset.of].filter(Boolean).join(", "),
  tell(table, cell) {
    this.shut(table);
    this.stop(table, cell);
    const row = cell.parentElement, head = table.tHead.rows[0].cells[cell.cellIndex];
    const name = this.name(row), what = novags.tables.text(head);
    const near = novags.rows.of(table).filter((other) => other.dataset.of === row.dataset.of);  // of the same combination
    const rivals = near.filter((other) => other.cells[cell.cellIndex].dataset.rank).length;
    const place = cell.dataset.rank ? `, place ${cell.dataset.rank} of ${rivals}` : "";
    const box = document.createElement("div");
    box.className = "told";
    box.innerHTML = '<strong></strong> <span class="muted">Make it again, in the folder of this page:</span><pre></pre><div><button type="button">Copy</button><button type="button">Show its pictures</button><button type="button">Close</button></div>';
    box.querySelector("strong").textContent = `${name}, ${what}: ${cell.dataset.value || "no value"}${place}.`;
    box.querySelector("pre").textContent = row.dataset.command;
    const [copy, look, close] = box.querySelectorAll("button");
    copy.addEventListener("click", () => novags.tables.copy(row.dataset.command, copy));
    look.hidden = !("view" in row.dataset);
    look.addEventListener("click", () => novags.look.open(row.dataset.view, row.dataset.picture));
    close.addEventListener("click", () => {
      this.shut(table);
      cell.focus();
    });
    table.parentElement.after(box);
    novags.state.set(`cell.${table.dataset.name}`, `${cell.cellIndex}:${name}`);
  },
  shut(table) {
    const next = table.parentElement.nextElementSibling;
    if (next?.classList.contains("told")) next.remove();
    novags.state.set(`cell.${table.dataset.name}`, "");
  },
  move(table, cell, key) {
    const row = cell.parentElement, at = cell.cellIndex;
    const beside = (way) => {
      let other = row[way];
      while (other?.hidden) other = other[way];
      return other?.cells[at];
    };
    const along = (step) => {
      let k = at + step;
      while (row.cells[k] && !this.isShown(row.cells[k])) k += step;
      return row.cells[k];
    };
    const next = { ArrowLeft: along(-1), ArrowRight: along(1), ArrowUp: beside("previousElementSibling"), ArrowDown: beside("nextElementSibling") }[key];
    if (!next?.classList.contains("num")) return;
    this.stop(table, next);
    next.focus();
  },
};

novags.parts.push({
  adopt(root) {
    for (const table of root.querySelectorAll("table[data-name]")) this.table(table);
  },
  table(table) {
    table.tBodies[0].addEventListener("click", (event) => {
      const row = event.target.closest("tr[data-view] :is(th, td:not(.num))")?.parentElement;
      if (row) novags.look.open(row.dataset.view, row.dataset.picture);
    });
    const first = novags.cells.first(table);
    if (!first) return;
    novags.cells.stop(table, first);
    const asked = (event) => event.target.closest("tr[data-command] td.num");
    table.tBodies[0].addEventListener("click", (event) => asked(event) && novags.cells.tell(table, asked(event)));
    table.tBodies[0].addEventListener("keydown", (event) => {
      const cell = asked(event);
      if (!cell) return;
      if (event.key.startsWith("Arrow")) novags.cells.move(table, cell, event.key);
      else if (event.key === "Enter" || event.key === " ") novags.cells.tell(table, cell);
      else return;
      event.preventDefault();
    });
  },
  restore() {
    for (const table of novags.tables.all.keys()) {
      const [, column, name] = /^(\d+):(.*)$/.exec(novags.state.get(`cell.${table.dataset.name}`)) ?? [];
      const row = novags.rows.of(table).find((other) => other.dataset.command && novags.cells.name(other) === name);
      if (row?.cells[column]) novags.cells.tell(table, row.cells[column]);
    }
  },
});

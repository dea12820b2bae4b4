// Tables with many rows can be narrowed to single values of their axes.
novags.parts.push({
  tables: [],
  adopt(root) {
    for (const table of root.querySelectorAll("table[data-name]")) this.table(table);
  },
  table(table) {
    const box = document.createElement("div"), rows = [...novags.rows.of(table)], selects = [];
    box.className = "filters";
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      if (!("filter" in head.dataset)) return;
      const values = [...new Set(rows.map((row) => novags.tables.text(row.cells[column])))];
      if (values.length > 1) selects.push(this.select(table, head, column, values, box));
    });
    if (!selects.length) return;
    for (const select of selects) select.addEventListener("change", () => this.narrow(table, rows, selects));
    table.parentElement.previousElementSibling.before(box);
    this.tables.push({ table, rows, selects });
  },
  select(table, head, column, values, box) {
    const label = document.createElement("label"), select = document.createElement("select"), name = novags.tables.text(head);
    select.append(new Option("all", ""), ...values.map((value) => new Option(value, value)));
    select.dataset.key = `only.${table.dataset.name}.${name}`;
    select.dataset.column = column;
    select.addEventListener("change", () => novags.state.set(select.dataset.key, select.value));
    label.append(name, select);
    box.append(label);
    return select;
  },
  narrow(table, rows, selects) {
    for (const row of rows) {
      row.hidden = selects.some((select) => select.value && novags.tables.text(row.cells[select.dataset.column]) !== select.value);
    }
    novags.rows.show(table);
  },
  restore() {
    for (const { table, rows, selects } of this.tables) {
      for (const select of selects) {
        const wanted = novags.state.get(select.dataset.key);
        select.value = [...select.options].some((option) => option.value === wanted) ? wanted : "";
      }
      if (selects.some((select) => select.value) || rows.some((row) => row.hidden)) this.narrow(table, rows, selects);
    }
  },
});

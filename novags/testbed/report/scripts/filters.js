// Tables with many rows can be narrowed to single values of their axes, and some to rows that hold all words of a search.
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
    const search = table.classList.contains("searched") ? this.search(table, box) : null;
    if (!selects.length && !search) return;
    const found = { table, rows, selects, search };
    for (const select of selects) select.addEventListener("change", () => this.narrow(found));
    search?.addEventListener("input", () => this.narrow(found));
    table.parentElement.previousElementSibling.before(box);
    this.tables.push(found);
  },
  search(table, box) {
    const label = document.createElement("label"), search = document.createElement("input");
    search.type = "search";
    search.dataset.key = `find.${table.dataset.name}`;
    search.addEventListener("input", () => novags.state.set(search.dataset.key, search.value));
    label.append("Search", search);
    box.prepend(label);
    return search;
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
  narrow({ table, rows, selects, search }) {
    const words = (search?.value ?? "").toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of rows) {
      const text = words.length ? [...row.cells].filter((cell) => !cell.classList.contains("num")).map((cell) => cell.textContent).join(" ").toLowerCase() : "";
      row.hidden = words.some((word) => !text.includes(word))
        || selects.some((select) => select.value && novags.tables.text(row.cells[select.dataset.column]) !== select.value);
    }
    novags.rows.show(table);
  },
  restore() {
    for (const found of this.tables) {
      const { rows, selects, search } = found;
      if (search) search.value = novags.state.get(search.dataset.key);
      for (const select of selects) {
        const wanted = novags.state.get(select.dataset.key);
        select.value = [...select.options].some((option) => option.value === wanted) ? wanted : "";
      }
      if (search?.value || selects.some((select) => select.value) || rows.some((row) => row.hidden)) this.narrow(found);
    }
  },
});

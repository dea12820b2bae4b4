// Every table can be sorted, downloaded as CSV, and says when columns lie outside the screen.
novags.tables = {
  all: new Map(),

  text(cell) {
    if (!cell.firstElementChild) return cell.textContent.trim();
    const copy = cell.cloneNode(true);
    for (const extra of copy.querySelectorAll(".dagger, .arrow, .hidden-csv")) extra.remove();
    return copy.textContent.replace(/\s+/g, " ").trim();
  },
  value(cell) {
    return cell.dataset.value ?? this.text(cell);
  },
  number(text) {
    return text === "" ? NaN : Number(text === "inf" ? "Infinity" : text.replace("−", "-"));
  },

  sort(table, column, descending) {
    const heads = [...table.tHead.rows[0].cells], rows = [...novags.rows.of(table)];
    const keyed = rows.map((row) => ({ row, value: this.value(row.cells[column]) }));
    const numeric = keyed.every(({ value }) => value === "" || !Number.isNaN(this.number(value)));
    const sign = descending ? -1 : 1;
    keyed.sort((a, b) => {
      if (a.value === "" || b.value === "") return (a.value === "") - (b.value === "");  // unknown ones last, both ways
      if (numeric) return sign * (this.number(a.value) - this.number(b.value)) || 0;
      return sign * a.value.localeCompare(b.value, "en", { numeric: true });
    });
    novags.rows.order(table, keyed.map(({ row }) => row));
    heads.forEach((head, k) => {
      if (head.hasAttribute("aria-sort")) head.setAttribute("aria-sort", k !== column ? "none" : descending ? "descending" : "ascending");
    });
    if (heads[0].classList.contains("rank")) {
      const taken = {}, told = (row) => `${row.dataset.of ?? ""} ${row.cells[column].dataset.rank}`;
      for (const row of rows) taken[told(row)] = (taken[told(row)] ?? 0) + 1;
      for (const row of rows) {
        const { rank } = row.cells[column].dataset, place = row.cells[0];
        if (place.textContent !== "†") place.textContent = rank ? `${rank}${taken[told(row)] > 1 ? "=" : ""}` : "";
      }
    }
    novags.state.set(`sort.${table.dataset.name}`, `${column}${descending ? "d" : "a"}`);
  },

  press(table, column) {
    const head = table.tHead.rows[0].cells[column], now = head.getAttribute("aria-sort");
    if (now !== "none") return this.sort(table, column, now === "ascending");
    const more = head.dataset.better ? head.dataset.better === "more" : head.classList.contains("num");
    this.sort(table, column, more);
  },

  csv(table) {
    // As `novags.testbed.csv_text`: what a spreadsheet would compute is marked as text.
    const asText = (text) => (/^['=+\-@\t\r\n＝＋－＠]/.test(text) && Number.isNaN(Number(text)) ? `'${text}` : text);
    const quoted = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
    const all = novags.rows.of(table), heads = [...table.tHead.rows[0].cells];
    const marked = all.some((row) => row.querySelector(".dagger"));
    const rows = [...all, ...(table.tFoot ? table.tFoot.rows : [])].filter((row) => !row.hidden);
    const kinds = { sd: "standard deviation", error: "standard error", scenes: "scenes" };  // said beside a mean
    const beside = heads.map((_, k) => Object.keys(kinds).filter((kind) => rows.some((row) => kind in row.cells[k].dataset)));
    const named = (cell) => (cell.classList.contains("rank") ? "place" : this.text(cell));
    const told = heads.flatMap((cell, k) => [named(cell), ...beside[k].map((kind) => `${named(cell)}, ${kinds[kind]}`)]);
    const line = (row) => [...row.cells].flatMap((cell, k) => [this.value(cell).replace("†", ""), ...beside[k].map((kind) => cell.dataset[kind] ?? "")]);
    const lines = [[...told, ...(marked ? ["sees truth"] : [])]];
    for (const row of rows) lines.push([...line(row), ...(marked ? [row.querySelector(".dagger") ? "yes" : "no"] : [])]);
    return lines.map((cells) => cells.map(asText).map(quoted).join(",") + "\n").join("");
  },

  // What is shown, as a table for a paper or for a page: folded columns stay away, the best of a column is bold.
  shown(table) {
    const cells = (row) => [...row.cells].filter(novags.cells.isShown);
    const rows = [...novags.rows.of(table), ...(table.tFoot ? table.tFoot.rows : [])].filter((row) => !row.hidden);
    const said = (cell) => this.text(cell) + (cell.querySelector(".dagger") ? "†" : "");
    const heads = cells(table.tHead.rows[0]);
    const shown = heads.map((head) => head.cellIndex);
    return {
      heads: heads.map((head) => (head.classList.contains("rank") ? "#" : said(head))), right: heads.map((head) => head.classList.contains("num")),
      rows: rows.map((row) => shown.map((k) => ({ text: said(row.cells[k]), best: row.cells[k].classList.contains("best") }))),
    };
  },
  markdown(table) {
    const { heads, right, rows } = this.shown(table), safe = (text) => text.replaceAll("|", "\\|");
    const line = (texts) => `| ${texts.join(" | ")} |\n`;
    return line(heads.map(safe)) + line(right.map((on) => (on ? "---:" : "---")))
      + rows.map((row) => line(row.map(({ text, best }) => (best ? `**${safe(text)}**` : safe(text))))).join("");
  },
  // For booktabs.
  latex(table) {
    const { heads, right, rows } = this.shown(table);
    const signs = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}", "±": "$\\pm$", "−": "$-$", "†": "$^\\dagger$", "°": "$^\\circ$", "×": "$\\times$" };
    const safe = (text) => text.replace(/[\\~^±−†°×&%$#_{}]/g, (sign) => signs[sign] ?? `\\${sign}`);
    const line = (texts) => `${texts.join(" & ")} \\\\\n`;
    const body = rows.map((row) => line(row.map(({ text, best }) => (best ? `\\textbf{${safe(text)}}` : safe(text)))));
    return `\\begin{tabular}{${right.map((on) => (on ? "r" : "l")).join("")}}\n\\toprule\n${line(heads.map(safe))}\\midrule\n${body.join("")}\\bottomrule\n\\end{tabular}\n`;
  },
  async copy(text, button) {
    const before = button.textContent;
    try {
      await navigator.clipboard.writeText(text);
    } catch {  // some browsers refuse it to pages from files
      const area = Object.assign(document.createElement("textarea"), { value: text });
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    button.textContent = "Copied";
    setTimeout(() => (button.textContent = before), 1500);
  },

  download(table) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([this.csv(table)], { type: "text/csv" }));
    link.download = `${table.dataset.name.replace(/[^\w.-]+/g, "-")}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  },

  // How many columns are not, or not wholly, on the screen.
  hint(scroll, table, note) {
    const wider = scroll.scrollWidth > scroll.clientWidth + 1;
    scroll.classList.toggle("wider", wider);
    note.hidden = !wider;
    if (!wider) return;
    const edge = scroll.getBoundingClientRect().right + 1;
    const beyond = [...table.tHead.rows[0].cells].filter((cell) => cell.getBoundingClientRect().right > edge).length;
    note.textContent = beyond ? `→ ${beyond} more ${beyond === 1 ? "column" : "columns"}` : "← more columns";
  },
};

novags.parts.push({
  adopt(root) {
    for (const table of root.querySelectorAll("table[data-name]")) this.table(table);
  },
  table(table) {
    const { tables } = novags, scroll = table.parentElement, over = document.createElement("div");
    const heads = [...table.tHead.rows[0].cells], rows = [...novags.rows.of(table)];
    over.className = "over";
    over.innerHTML = '<span class="more" hidden></span><span>Copy as</span><button type="button">LaTeX</button><button type="button">Markdown</button><button type="button">CSV</button><button type="button">Save</button>';
    const [note, , ...copies] = over.children, save = copies.pop(), name = scroll.getAttribute("aria-label");
    for (const button of copies) {
      const kind = button.textContent;
      button.setAttribute("aria-label", `Copy “${name}” as ${kind}`);
      button.addEventListener("click", () => tables.copy(tables[kind.toLowerCase()](table), button));
    }
    save.setAttribute("aria-label", `Download “${name}” as CSV`);
    save.addEventListener("click", () => tables.download(table));
    scroll.before(over);
    heads.forEach((head, column) => {
      if (head.classList.contains("rank")) return;
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      head.setAttribute("aria-sort", head.dataset.sorted ?? "none");
      button.addEventListener("click", () => tables.press(table, column));
    });
    tables.all.set(table, { rows, places: rows.map((row) => row.cells[0].textContent), sorted: heads.map((head) => head.getAttribute("aria-sort")) });
    new ResizeObserver(() => tables.hint(scroll, table, note)).observe(scroll);
    scroll.addEventListener("scroll", () => tables.hint(scroll, table, note), { passive: true });
  },
  restore() {
    for (const [table, first] of novags.tables.all) {
      const [, column, way] = /^(\d+)([ad])$/.exec(novags.state.get(`sort.${table.dataset.name}`)) ?? [];
      const heads = [...table.tHead.rows[0].cells];
      if (column !== undefined && heads[column]?.hasAttribute("aria-sort")) {
        novags.tables.sort(table, +column, way === "d");
      } else if (heads.some((head, k) => head.getAttribute("aria-sort") !== first.sorted[k])) {
        novags.rows.order(table, [...first.rows]);
        heads.forEach((head, k) => head.hasAttribute("aria-sort") && head.setAttribute("aria-sort", first.sorted[k]));
        if (heads[0].classList.contains("rank")) first.rows.forEach((row, k) => (row.cells[0].textContent = first.places[k]));
      }
    }
  },
});

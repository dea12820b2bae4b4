// What is open, sorted and compared, kept in the address: a link to the page shows it as it is now.
const novags = {
  data: JSON.parse(document.getElementById("data").textContent),
  // They have restore(), for whenever the address changes, start(), once, or adopt(root), for what the page begins with and
  // for what is made later.
  parts: [],
  byId: (id) => document.getElementById(id),

  start() {
    this.state.read();
    for (const part of this.parts) part.start?.();
    this.adopt(document);
    this.restore();
    addEventListener("hashchange", () => {
      this.state.read();
      this.restore();
    });
  },
  adopt(root) {
    for (const part of this.parts) part.adopt?.(root);
  },
  // Long tables, and the pictures of all views but the first, are text until they are asked for: the page opens at once.
  unpack(box) {
    const kept = box.querySelector(":scope > script.late"), made = document.createElement("template");
    if (!kept) return false;
    made.innerHTML = kept.textContent;
    kept.replaceWith(made.content);
    return true;
  },
  restore() {
    for (const part of this.parts) part.restore?.();
    const target = this.byId(this.state.get("at"));
    if (target) target.scrollIntoView();
  },
};

novags.state = {
  values: new URLSearchParams(),
  timer: 0,
  read() {
    const text = location.hash.slice(1);
    this.values = new URLSearchParams(text.includes("=") ? text : "");  // without one it is a plain anchor
  },
  get(key) {
    return this.values.get(key) ?? "";
  },
  set(key, value) {
    if (this.get(key) === String(value ?? "")) return;
    if (value === "" || value === null || value === undefined) this.values.delete(key);
    else this.values.set(key, value);
    clearTimeout(this.timer);  // browsers refuse hundreds of changes in a row
    this.timer = setTimeout(() => history.replaceState(null, "", `#${this.values}`), 150);
  },
};

// Links at headings, and parts that unfold.
novags.parts.push({
  start() {
    for (const heading of document.querySelectorAll(":is(h2, h3, h4)[id]")) {
      const link = document.createElement("a");
      link.className = "anchor";
      link.href = `#at=${heading.id}`;
      link.textContent = "#";
      link.setAttribute("aria-label", `Link to “${heading.textContent}”`);
      heading.append(link);
    }
    for (const link of document.querySelectorAll(".anchor, .contents a")) {
      link.addEventListener("click", (event) => {
        const id = link.hash.split(/[#=]/).pop();
        event.preventDefault();
        novags.state.set("at", id);
        novags.byId(id).scrollIntoView();
      });
    }
    for (const part of document.querySelectorAll("details[id]")) {
      part.dataset.first = part.open ? "open" : "";
      part.addEventListener("toggle", () => {
        novags.state.set(part.id, this.changed(part) ? (part.open ? "open" : "shut") : "");
        if (part.open) this.unfold(part);
      });
    }
  },
  restore() {
    for (const part of document.querySelectorAll("details[id]")) {
      part.open = (novags.state.get(part.id) || (part.dataset.first ? "open" : "shut")) === "open";
    }
  },
  unfold(part) {
    if (!novags.unpack(part)) return;
    novags.adopt(part);
    for (const other of novags.parts) if (other.adopt) other.restore?.();
  },
  changed: (part) => part.open !== Boolean(part.dataset.first),
});

"use strict";
// Light, dark, or as the system says. Runs before the page is drawn, so that it never flashes.
(() => {
  const root = document.documentElement, themes = ["automatic", "light", "dark"];
  root.classList.add("js");
  const kept = () => {
    try { return localStorage.getItem("novags-theme") || "automatic"; } catch { return "automatic"; }  // refused to files
  };
  let theme = kept();
  function apply() {
    if (theme === "automatic") delete root.dataset.theme;
    else root.dataset.theme = theme;
    const button = document.getElementById("theme");
    if (button) button.textContent = `Theme: ${theme}`;
  }
  apply();
  document.addEventListener("DOMContentLoaded", () => {
    const button = document.getElementById("theme");
    button.hidden = false;
    apply();
    button.addEventListener("click", () => {
      theme = themes[(themes.indexOf(theme) + 1) % themes.length];
      try { localStorage.setItem("novags-theme", theme); } catch { /* it holds until the page is closed */ }
      apply();
    });
  });
})();

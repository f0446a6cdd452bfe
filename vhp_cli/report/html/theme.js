"use strict";
// The choice of light or dark, before anything is drawn.
(() => {
  let kept = null;
  try { kept = localStorage.getItem("vhp-theme"); } catch { /* no storage for pages from files */ }
  if (kept === "light" || kept === "dark") document.documentElement.dataset.theme = kept;
})();

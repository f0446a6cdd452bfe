"use strict";
// Tables that sort, the filter of tissues, light and dark.
(() => {
  const all = (query, from = document) => [...from.querySelectorAll(query)];

  document.getElementById("theme").addEventListener("click", () => {
    const root = document.documentElement;
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    try { localStorage.setItem("vhp-theme", root.dataset.theme); } catch { /* as above */ }
    document.dispatchEvent(new CustomEvent("vhp-theme"));
  });

  const collator = new Intl.Collator("en", { numeric: true });
  for (const table of all("table.sortable")) {
    all("thead th", table).forEach((heading, column) => {
      const numeric = heading.classList.contains("n");
      heading.querySelector("button").addEventListener("click", () => {
        const down = heading.getAttribute("aria-sort") === "ascending";
        all("thead th", table).forEach(other => other.removeAttribute("aria-sort"));
        heading.setAttribute("aria-sort", down ? "descending" : "ascending");
        const body = table.tBodies[0];
        const rows = [...body.rows].map((row, index) => ({ row, index, key: row.cells[column].dataset.v }));
        const isNumber = numeric || rows.every(({ key }) => key === undefined || !Number.isNaN(Number(key)));
        rows.sort((a, b) => {
          if (a.key === undefined || b.key === undefined) {
            return (a.key === undefined) - (b.key === undefined) || a.index - b.index;
          }
          const order = isNumber ? Number(a.key) - Number(b.key) : collator.compare(a.key, b.key);
          return (down ? -order : order) || a.index - b.index;
        });
        body.append(...rows.map(({ row }) => row));
      });
    });
  }

  const filter = document.getElementById("filter"), verdict = document.getElementById("verdict");
  const rows = all("table.tissues tbody tr");
  const cardOf = rows.map(row => document.getElementById(`tissue-${row.querySelector("[data-tissue]").dataset.tissue}`));
  const texts = rows.map(row => row.textContent.toLowerCase());
  function narrow() {
    const wanted = filter.value.trim().toLowerCase();
    let count = 0;
    rows.forEach((row, index) => {
      const level = cardOf[index].dataset.verdict;
      const fits = texts[index].includes(wanted) && (!verdict.value || level === verdict.value);
      row.hidden = cardOf[index].hidden = !fits;
      count += fits;
    });
    document.getElementById("match-count").textContent = count < rows.length ? `${count} of ${rows.length}` : "";
  }
  filter.addEventListener("input", narrow);
  verdict.addEventListener("change", narrow);
  filter.form.addEventListener("submit", event => event.preventDefault());
  // A form that the browser filled in from an earlier visit.
  narrow();

  // Without a viewer, a tissue leads to its card.
  if (!document.getElementById("viewer")) {
    document.addEventListener("click", event => {
      const button = event.target.closest("[data-tissue]");
      const card = button && document.getElementById(`tissue-${button.dataset.tissue}`);
      if (card) { card.querySelector("details").open = true; card.scrollIntoView({ block: "center" }); }
    });
  }
})();

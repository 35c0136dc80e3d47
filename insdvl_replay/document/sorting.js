"use strict";
for (const table of document.querySelectorAll("table")) {
  table.querySelectorAll("thead th").forEach((header, column) => {
    const button = document.createElement("button");
    button.append(...header.childNodes);
    header.append(button);
    button.addEventListener("click", () => {
      const up = header.getAttribute("aria-sort") !== "ascending";
      for (const other of header.parentNode.children) other.removeAttribute("aria-sort");
      header.setAttribute("aria-sort", up ? "ascending" : "descending");
      const body = table.tBodies[0];
      body.append(...[...body.rows].sort((a, b) => compare(a.cells[column], b.cells[column], up)));
    });
  });
}

/** Numbers by size, words by alphabet; missing values are last in both directions. */
function compare(first, second, up) {
  const [a, b] = [first.textContent, second.textContent];
  const missing = (a === "-" || a === "") - (b === "-" || b === "");
  if (missing) return missing;
  const [x, y] = [parseFloat(a), parseFloat(b)];
  const order = Number.isNaN(x) || Number.isNaN(y) ? a.localeCompare(b) : x - y;
  return up ? order : -order;
}

// Tables that can be sorted by their heads and filtered; hints beside the pointer.  Without this
// script the page is the same, as it was written.
"use strict";

const number = (text) => {
  const value = parseFloat(text.replace(/[,\u00a0]/g, ""));
  return Number.isNaN(value) ? null : value;
};

function compare(one, other) {
  const a = number(one), b = number(other);
  if (a !== null && b !== null) return a - b;
  if (a !== null || b !== null) return a === null ? 1 : -1;  // what is not known stands last
  return one.localeCompare(other);
}

// Sort every group of rows by one column; a second time, the other way round.
function sortBy(table, head, column) {
  const down = head.getAttribute("aria-sort") === "ascending";
  for (const other of table.querySelectorAll("thead th")) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  for (const body of table.tBodies) {
    const rows = [...body.rows].filter((row) => !row.classList.contains("group"));
    const text = (row) => row.cells[column].textContent.trim();
    rows.sort((one, other) => (down ? -1 : 1) * compare(text(one), text(other)));
    body.append(...rows);
  }
}

function makeSortable(table) {
  [...table.querySelectorAll("thead th")].forEach((head, column) => {
    head.tabIndex = 0;
    const sort = () => sortBy(table, head, column);
    head.addEventListener("click", sort);
    head.addEventListener("keydown", (event) => {
      if (event.key === "Enter") sort();
    });
  });
}

// A field above a long table that leaves the rows which hold what is typed.
function makeFilterable(table) {
  const rows = [...table.querySelectorAll("tbody tr:not(.group)")];
  if (rows.length < 6) return;
  const field = document.createElement("input");
  field.type = "search";
  field.className = "filter";
  field.placeholder = "filter rows";
  field.setAttribute("aria-label", "filter rows");
  field.addEventListener("input", () => {
    const wanted = field.value.toLowerCase();
    for (const row of rows) row.hidden = !row.textContent.toLowerCase().includes(wanted);
  });
  table.closest(".scroll").before(field);
}

for (const table of document.querySelectorAll("table")) {
  makeSortable(table);
  makeFilterable(table);
}
// What is linked to is opened.
const reveal = () => {
  const target = location.hash && document.getElementById(location.hash.slice(1));
  if (!target) return;
  for (const part of target.querySelectorAll(":scope > details")) part.open = true;
};
addEventListener("hashchange", reveal);
reveal();

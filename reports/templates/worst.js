// A backend's name in a table opens its worst QPs; the rows are those of tables/worst.csv.
const worst = JSON.parse(document.getElementById("worst").textContent);

function element(name, text, parent) {
  const made = document.createElement(name);
  if (text !== null) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

// A paragraph for every QP, and its command in a line that can be marked.
function tellQps(box, solver, rows) {
  box.replaceChildren();
  const close = element("button", "close", box);
  close.addEventListener("click", () => box.close());
  element("h2", `${solver}: its worst QPs`, box);
  for (const row of rows) {
    const [, scene, qp, setting, arm, verdict, error, bound, status, command] = row;
    const said = `${scene}, QP ${qp}, ${setting}, ${arm}: ${verdict}. Error ${error} and bound ${bound}` +
      ` times the accuracy asked.${status ? ` Status: ${status}.` : ""}`;
    element("p", said, box);
    element("pre", command, box);
  }
}

function openWorst(box, solver, scene) {
  const own = worst.rows.filter((row) => row[0] === solver);
  const here = own.filter((row) => row[1] === scene);
  tellQps(box, solver, here.length ? here : own);
  box.showModal();
}

function makeOpenable(table, box, known) {
  const head = [...table.querySelectorAll("thead th")].findIndex((th) => th.textContent === "solver");
  if (head < 0) return;
  for (const row of table.querySelectorAll("tbody tr:not(.group)")) {
    const cell = row.cells[head], solver = cell.textContent;
    if (!known.has(solver)) continue;
    cell.className += " opens";
    cell.tabIndex = 0;
    cell.title = "show its worst QPs";
    const scene = row.parentElement.querySelector(".group")?.textContent;
    cell.addEventListener("click", () => openWorst(box, solver, scene));
    cell.addEventListener("keydown", (event) => event.key === "Enter" && openWorst(box, solver, scene));
  }
}

const dialog = element("dialog", null, document.body);
const known = new Set(worst.rows.map((row) => row[0]));
for (const table of document.querySelectorAll("table")) makeOpenable(table, dialog, known);

"use strict";
// A click on a column's name sorts its table by it, numbers before texts; another click turns the order round.
// A click on a picture shows it in its own size, another fits it to the page.
function compare(a, b) {
  const [x, y] = [a, b].map((text) => (text === "" ? NaN : Number(text)));
  if (!Number.isNaN(x) && !Number.isNaN(y)) return x - y;
  if (Number.isNaN(x) !== Number.isNaN(y)) return Number.isNaN(x) ? 1 : -1;
  return a.localeCompare(b);
}

function sortBy(header) {
  const table = header.closest("table");
  const body = table.tBodies[0];
  const column = header.cellIndex;
  const turn = header.getAttribute("aria-sort") === "ascending" ? -1 : 1;
  for (const other of header.parentElement.cells) other.removeAttribute("aria-sort");
  header.setAttribute("aria-sort", turn === 1 ? "ascending" : "descending");
  const value = (row) => row.cells[column].dataset.value;
  body.append(...[...body.rows].sort((a, b) => turn * compare(value(a), value(b))));
}

for (const button of document.querySelectorAll("th button")) {
  button.addEventListener("click", () => sortBy(button.parentElement));
}
for (const picture of document.querySelectorAll("figure img")) {
  picture.addEventListener("click", () => picture.classList.toggle("whole"));
}

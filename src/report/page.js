"use strict";
// What stands at a dot is said beside it; a thumbnail opens in full.
const said = document.createElement("div");
said.id = "said";
said.hidden = true;
document.body.append(said);
function say(event) {
  const svg = event.target.closest && event.target.closest("svg");
  let nearest = null;
  if (svg) {
    const box = svg.getBoundingClientRect();
    const view = svg.viewBox.baseVal;
    const scale = view.width / box.width;
    const x = view.x + (event.clientX - box.left) * scale;
    const y = view.y + (event.clientY - box.top) * scale;
    let least = 24 * scale;
    for (const dot of svg.querySelectorAll("[data-tip]")) {
      const away = Math.hypot(dot.cx.baseVal.value - x, dot.cy.baseVal.value - y);
      if (away < least) [least, nearest] = [away, dot];
    }
  }
  said.hidden = !nearest;
  if (!nearest) return;
  said.textContent = nearest.dataset.tip;
  const right = document.documentElement.clientWidth - said.offsetWidth - 8;
  said.style.left = Math.max(8, Math.min(event.clientX + 12, right)) + "px";
  said.style.top = event.clientY + 16 + "px";
}
// A click on a column's name sorts the rows by it, a second one the other way round; numbers by their size, with empty cells last.
function sort(header) {
  const rows = [...header.closest("table").rows].slice(1);
  const column = header.cellIndex;
  const down = header.ariaSort === "ascending";
  for (const other of header.parentElement.cells) other.ariaSort = null;
  header.ariaSort = down ? "descending" : "ascending";
  const value = (row) => row.cells[column].textContent.replace("−", "-");
  const compare = (a, b) => {
    const [x, y] = [parseFloat(a), parseFloat(b)];
    return Number.isFinite(x) && Number.isFinite(y) ? x - y : a.localeCompare(b);
  };
  const empty = (row) => !value(row);
  rows.sort((a, b) => empty(a) - empty(b) || (down ? -1 : 1) * compare(value(a), value(b)));
  header.closest("tbody").append(...rows);
}
for (const header of document.querySelectorAll(".sortable th")) {
  header.tabIndex = 0;
  header.title = "sort by this column";
  header.addEventListener("click", () => sort(header));
  header.addEventListener("keydown", (event) => { if (event.key === "Enter") sort(header); });
}
addEventListener("pointermove", say);
addEventListener("pointerdown", say);
addEventListener("scroll", () => { said.hidden = true; });
for (const link of document.querySelectorAll("a.full")) {
  link.addEventListener("click", (event) => {
    const dialog = document.getElementById("full");
    dialog.querySelector("img").src = link.querySelector("img").src;
    dialog.querySelector("p").textContent = link.title;
    dialog.showModal();
    event.preventDefault();
  });
}
for (const dialog of document.querySelectorAll("dialog")) dialog.addEventListener("click", () => dialog.close());

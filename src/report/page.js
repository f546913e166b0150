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

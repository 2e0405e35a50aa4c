"use strict";
// The dot nearest to the pointer shows its setting, its time and error, and its command; a click keeps it.
const REACH = 24; // pixels between the pointer and a dot
const told = document.getElementById("told");
const [name, numbers, command, copy] = ["strong", "span", "code", "button"].map((tag) => told.querySelector(tag));
let chosen = null;
let isKept = false;

function show(dot) {
  if (chosen) chosen.classList.remove("chosen");
  chosen = dot;
  dot.classList.add("chosen");
  const texts = JSON.parse(dot.dataset.dot);
  [name.textContent, numbers.textContent, command.textContent] = texts;
  copy.hidden = !texts[2];
}

function findNearest(picture, x, y) {
  let [nearest, least] = [null, REACH];
  for (const dot of picture.querySelectorAll("g[data-dot]")) {
    const box = dot.getBoundingClientRect();
    const distance = Math.hypot(box.x + box.width / 2 - x, box.y + box.height / 2 - y);
    if (distance < least) [nearest, least] = [dot, distance];
  }
  return nearest;
}

for (const picture of document.querySelectorAll("section svg")) {
  const follow = (event, keeps) => {
    const dot = findNearest(picture, event.clientX, event.clientY);
    if (keeps) isKept = dot !== null;
    if (dot && (keeps || !isKept)) show(dot);
  };
  picture.addEventListener("pointermove", (event) => follow(event, false));
  picture.addEventListener("click", (event) => follow(event, true));
}
copy.addEventListener("click", () => navigator.clipboard.writeText(command.textContent));

"use strict";
// Draws error against time, logarithmic, in the design of the charts of `mbsrun chart`: a line and a name for each
// method, the front as a quiet band, the chosen dot in a ring; downwards and left is better. Needs front.js.
//
//   drawFront(svg, { dots, floor }, asked, width);

const COLORS = ["#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7", "#8c6d31"]; // as in mbsgen.style
const [TEXT, HIGH, LEFT, BOTTOM, MARK, WORST] = [12, 300, 52, 24, 3.3, 10];
const RINGS = [4, 11, 19, 27, 37, 50, 66], WAYS = [0, 45, -45, 90, -90, 135, -135, 180].map((x) => (x * Math.PI) / 180);

function chooseTicks(low, high, most) { // powers of ten, with 1, 2, 5 or 1, 3 between them where there is room
  const first = Math.floor(Math.log10(low)), last = Math.ceil(Math.log10(high)), decades = [];
  for (let k = first; k <= last; k++) decades.push(k);
  const within = (x) => low <= x && x <= high;
  for (const shares of [[1, 2, 3, 4, 5, 6, 8], [1, 2, 5], [1, 3], [1]]) {
    const found = decades.flatMap((k) => shares.map((share) => Number(`${share}e${k}`))).filter(within);
    if (found.length <= most) return found;
  }
  for (let step = 2; ; step++) {
    const found = decades.filter((k) => k % step === 0).map((k) => Number(`1e${k}`)).filter(within);
    if (found.length <= most) return found;
  }
}

function drawFront(svg, { dots, floor }, asked, width) {
  const add = (kind, attributes, text) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", kind);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text !== undefined) made.textContent = text;
    return svg.appendChild(made);
  };
  svg.replaceChildren();
  svg.setAttribute("viewBox", `0 0 ${width} ${HIGH}`);
  svg.setAttribute("height", HIGH);
  const good = dots.filter(isGood);
  if (!good.length) return;

  const least = Math.min(asked, ...good.map((dot) => dot.error).filter((x) => x > 0)) / 10;
  const clamp = (error) => Math.min(Math.max(error, least), WORST);
  const range = (values, before, after) => {
    const [low, high] = [Math.min(...values), Math.max(...values)], span = Math.max(Math.log(high / low), 0.5);
    return [low * Math.exp(-before * span), high * Math.exp(after * span)];
  };
  const works = range(good.map((dot) => dot.work), 0.06, 0.12), errors = range([asked, ...good.map((dot) => clamp(dot.error))], 0.1, 0.08);
  const [right, bottom] = [width - 4, HIGH - BOTTOM];
  const along = (x, [low, high]) => Math.log(x / low) / Math.log(high / low);
  const at = ({ work, error }) => [LEFT + (right - LEFT) * along(work, works), bottom - (bottom - 4) * along(clamp(error), errors)];

  // --- frame ---
  const taken = []; // boxes that names keep clear of: left, top, right, bottom
  if (floor > errors[0]) {
    const top = at({ work: works[0], error: floor })[1];
    add("rect", { x: LEFT, y: top, width: right - LEFT, height: bottom - top, class: "shade" });
  }
  for (const work of chooseTicks(...works, Math.max(2, Math.floor((right - LEFT) / 80)))) {
    const [x] = at({ work, error: asked });
    add("path", { d: `M${x},4V${bottom + 4}`, class: "grid" });
    const isLast = x > right - 20; // its label would pass the edge
    add("text", { x: isLast ? right : x, y: bottom + 18, "text-anchor": isLast ? "end" : "middle", class: "quiet" }, writeTime(work));
  }
  for (const error of chooseTicks(...errors, 6)) {
    const y = at({ work: works[0], error })[1];
    add("path", { d: `M${LEFT - 4},${y}H${right}`, class: "grid" });
    add("text", { x: LEFT - 7, y: y + 4, "text-anchor": "end", class: "quiet" }, writeError(error));
  }
  add("path", { d: `M${LEFT},4V${bottom}H${right}`, class: "frame" });
  const level = at({ work: works[0], error: asked })[1];
  add("path", { d: `M${LEFT},${level}H${right}`, class: "asked" });
  taken.push([LEFT, level - 1, right, level + 1]);

  // --- the front, lines, dots ---
  const front = findFront(dots).map(at), choice = findChoice(dots, asked);
  if (front.length > 1) add("polyline", { points: front.join(" "), class: "front" });
  const names = [...new Set(good.map((dot) => dot.line))].slice(0, COLORS.length), lines = new Map();
  names.forEach((name, i) => {
    const line = findFront(good.filter((dot) => dot.line === name)).map(at);
    lines.set(name, line);
    add("polyline", { points: line.join(" "), class: "line", stroke: COLORS[i] });
    line.forEach(([x, y], k) => {
      add("circle", { cx: x, cy: y, r: MARK, fill: COLORS[i] });
      const [a, b] = line[Math.max(k - 1, 0)], count = Math.ceil(Math.hypot(x - a, y - b) / 3) + 1;
      for (let m = 0; m <= count; m++) {
        const [u, v] = [a + (x - a) * m / count, b + (y - b) * m / count];
        taken.push([u - 2, v - 2, u + 2, v + 2]);
      }
    });
  });
  if (choice) {
    const [x, y] = at(choice);
    add("circle", { cx: x, cy: y, r: 8, class: "choice" });
    taken.push([x - 9, y - 9, x + 9, y + 9]);
  }

  // --- names ---
  const measure = (text) => {
    const probe = add("text", { class: "name" }, text), { width: wide } = probe.getBBox();
    probe.remove();
    return wide;
  };
  const isFree = (box) => box[0] >= LEFT + 2 && box[2] <= right && box[1] >= 2 && box[3] <= bottom - 2
    && !taken.some((other) => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3]);
  const write = (text, places, attributes, end) => { // at the first free place; returns whether there is one
    const wide = measure(text) + 2;
    for (const [x, y] of places(wide)) {
      const box = [x, y, x + wide, y + TEXT + 3];
      if (!isFree(box)) continue;
      if (end && Math.hypot(Math.max(x - end[0], end[0] - box[2], 0), Math.max(y - end[1], end[1] - box[3], 0)) > 14) {
        const near = [Math.min(Math.max(end[0], x), box[2]), Math.min(Math.max(end[1], y), box[3])];
        add("path", { d: `M${end}L${near}`, class: "leader", stroke: attributes.fill });
      }
      add("text", { x: x + 1, y: y + TEXT, class: "name", ...attributes }, text);
      taken.push(box);
      return true;
    }
    return false;
  };
  write("↙ better", () => [[LEFT + 4, bottom - TEXT - 6]], { class: "name quiet" });
  names.forEach((name, i) => {
    const line = lines.get(name), ends = [line[line.length - 1], line[0]];
    for (const end of ends) {
      const places = (wide) => RINGS.flatMap((ring) => WAYS.map((way) => {
        const [c, s] = [Math.cos(way), -Math.sin(way)], side = (x) => (Math.abs(x) < 0.1 ? 0 : Math.sign(x));
        return [end[0] + c * (ring + MARK) + (side(c) - 1) * wide / 2, end[1] + s * (ring + MARK) + (side(s) - 1) * (TEXT + 3) / 2];
      }));
      if (write(name, places, { fill: COLORS[i] }, end)) break;
    }
  });
  const text = `asked: ${writeError(asked)}`;
  write(text, (wide) => [right, LEFT + 4 + wide, (right + LEFT + wide) / 2].flatMap((x) => [[x - wide, level - TEXT - 5], [x - wide, level + 2]]), { class: "name quiet" });
}

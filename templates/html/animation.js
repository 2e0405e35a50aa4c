"use strict";
// Plays the motion of the page's block #motion: poses of frames over time, in a view that orbits a point.
// Names are only ever set as text.
const motion = JSON.parse(document.getElementById("motion").textContent);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const places = new Float32Array(bytes(motion.places)); // [time][frame][x, y, z]
const turns = new Int16Array(bytes(motion.turns)); // [time][frame][x, y, z, w], unit quaternions times 32767
const frames = motion.frames, F = frames.length, K = motion.times;
const byId = (id) => document.getElementById(id);
const canvas = byId("scene"), pen = canvas.getContext("2d"), slider = byId("time");

// --- poses ----------------------------------------------------------------------------------------------------------

function place(k, f) { // a point at grid time k, which may lie between two
  const a = Math.min(Math.floor(k), K - 1), b = Math.min(a + 1, K - 1), s = k - a;
  const i = 3 * (a * F + f), j = 3 * (b * F + f);
  return [0, 1, 2].map((c) => places[i + c] + s * (places[j + c] - places[i + c]));
}

function axes(k, f) { // the frame's axes, as three vectors
  const i = 4 * (Math.round(k) * F + f);
  const [x, y, z, w] = [0, 1, 2, 3].map((c) => turns[i + c] / 32767);
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

// --- view -----------------------------------------------------------------------------------------------------------

const low = [0, 0, 0], high = [0, 0, 0];
function include(p) {
  for (let c = 0; c < 3; c++) { low[c] = Math.min(low[c], p[c]); high[c] = Math.max(high[c], p[c]); }
}
for (let i = 0; i < places.length; i += 3) include(places.subarray(i, i + 3));
motion.markers.forEach((m) => include(m.at));
const size = Math.max(Math.hypot(...high.map((h, c) => h - low[c])), 1e-6);
const home = () => ({ azimuth: -0.9, elevation: 0.38, zoom: 1, centre: high.map((h, c) => (h + low[c]) / 2) });
let view = home(), width = 1, height = 1;

function camera() { // right, up and towards the eye, in the base frame
  const [ca, sa] = [Math.cos(view.azimuth), Math.sin(view.azimuth)];
  const [ce, se] = [Math.cos(view.elevation), Math.sin(view.elevation)];
  return [[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]];
}
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

function projector() {
  const [right, up, eye] = camera(), distance = 2.6 * size;
  const scale = 0.92 * view.zoom * Math.min(width, height - 130) / size;
  return (p) => {
    const d = p.map((x, c) => x - view.centre[c]), depth = dot(d, eye);
    const s = scale * distance / Math.max(distance - depth, 0.05 * distance);
    return { x: width / 2 + s * dot(d, right), y: (height - 40) / 2 - s * dot(d, up), depth, near: s / scale };
  };
}

// --- drawing --------------------------------------------------------------------------------------------------------

let color = {};
function readColors() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["faint", "ink", "body", "slide", "joint", "sensor", "marker"]) {
    color[name] = style.getPropertyValue("--" + name).trim();
  }
}

function line(points, stroke, thickness) {
  pen.beginPath();
  points.forEach((p, i) => (i ? pen.lineTo(p.x, p.y) : pen.moveTo(p.x, p.y)));
  pen.strokeStyle = stroke;
  pen.lineWidth = thickness;
  pen.stroke();
}

function dashed(points, stroke, pattern) {
  pen.setLineDash(pattern);
  line(points, stroke, 2);
  pen.setLineDash([]);
}

function disc(p, radius, fill) {
  pen.beginPath();
  pen.arc(p.x, p.y, radius, 0, 2 * Math.PI);
  pen.fillStyle = fill;
  pen.fill();
}

function ground(project) { // a grid through the base, of a round spacing
  const step = 10 ** Math.round(Math.log10(size / 6)), reach = Math.ceil(0.75 * size / step);
  const [cx, cy] = [0, 1].map((c) => Math.round((high[c] + low[c]) / 2 / step));
  for (let i = -reach; i <= reach; i++) {
    const ends = (a, b) => [project(a), project(b)];
    line(ends([(cx + i) * step, (cy - reach) * step, 0], [(cx + i) * step, (cy + reach) * step, 0]), color.faint, 1);
    line(ends([(cx - reach) * step, (cy + i) * step, 0], [(cx + reach) * step, (cy + i) * step, 0]), color.faint, 1);
  }
}

function triad(project, origin, vectors, length) {
  ["#d1495b", "#3a9d5d", "#3b7dd8"].forEach((hue, c) => {
    line([project(origin), project(origin.map((x, i) => x + length * vectors[c][i]))], hue, 2);
  });
}

function star(p, radius) {
  pen.beginPath();
  for (let i = 0; i < 10; i++) {
    const r = i % 2 ? 0.42 * radius : radius, a = Math.PI * i / 5 - Math.PI / 2;
    pen.lineTo(p.x + r * Math.cos(a), p.y + r * Math.sin(a));
  }
  pen.closePath();
  pen.fillStyle = color.marker;
  pen.fill();
}

function draw() {
  const project = projector(), k = now();
  pen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.lineCap = pen.lineJoin = "round";
  ground(project);
  triad(project, [0, 0, 0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], 0.08 * size);
  if (byId("traces").checked) {
    frames.forEach((frame, f) => {
      if (!frame.sensor) return;
      const path = [];
      for (let i = 0; i < K; i++) path.push(project(place(i, f)));
      pen.globalAlpha = 0.3;
      line(path, color.sensor, 1.5);
      pen.globalAlpha = 1;
      line([...path.slice(0, Math.floor(k) + 1), project(place(k, f))], color.sensor, 2);
    });
  }
  const shapes = [];
  frames.forEach((frame, f) => {
    const p = place(k, f), end = project(p), thick = Math.max(2, 0.012 * Math.min(width, height)) * end.near;
    if (!(frame.parent < 0 && frame.slide)) { // a floating base hangs on nothing
      const start = project(frame.parent < 0 ? [0, 0, 0] : place(k, frame.parent));
      const stroke = frame.slide ? color.slide : color.body;
      shapes.push({ depth: (start.depth + end.depth) / 2, draw: () => line([start, end], stroke, frame.slide ? 2 : thick) });
    }
    const radius = frame.sensor ? 0.75 * thick : 0.6 * thick;
    shapes.push({ depth: end.depth + 1e-3 * size, draw: () => disc(end, radius, frame.sensor ? color.sensor : color.joint) });
    if (byId("axes").checked) shapes.push({ depth: end.depth + 2e-3 * size, draw: () => triad(project, p, axes(k, f), 0.06 * size) });
  });
  motion.links.forEach((link) => { // a rod, or a gap between ends that coincide where the loop is closed
    const ends = link.ends.map((f) => project(place(k, f)));
    const stroke = link.rod ? color.body : color.joint;
    shapes.push({ depth: (ends[0].depth + ends[1].depth) / 2, draw: () => dashed(ends, stroke, link.rod ? [] : [4, 4]) });
  });
  motion.markers.forEach((m) => {
    const p = project(m.at);
    shapes.push({ depth: p.depth, draw: () => star(p, 11 * p.near) });
  });
  shapes.sort((a, b) => a.depth - b.depth).forEach((shape) => shape.draw());
  disc(project([0, 0, 0]), 4, color.ink);
}

// --- time -----------------------------------------------------------------------------------------------------------

let seconds = 0, playing = false, before = 0, asked = false;
const span = motion.end - motion.start;
const now = () => (span > 0 ? Math.min((seconds / span) * (K - 1), K - 1) : 0);

function show() {
  slider.value = String(Math.round(now()));
  byId("clock").textContent = `${(motion.start + seconds).toFixed(2)} / ${motion.end.toFixed(2)} s`;
  draw();
}

function ask() { // to show, at the next refresh of the screen
  if (!asked) requestAnimationFrame(tick);
  asked = true;
}

function tick(at) {
  asked = false;
  if (playing) {
    seconds += (Math.min(at - before, 100) / 1000) * Number(byId("speed").value);
    if (seconds >= span) { seconds = span; setPlaying(false); }
  }
  before = at;
  show();
  if (playing) ask();
}

function setPlaying(wanted) {
  playing = wanted && span > 0;
  byId("play").textContent = playing ? "Pause" : "Play";
  if (playing && seconds >= span) seconds = 0;
  before = performance.now();
  ask();
}

function moveTo(wanted) {
  seconds = Math.max(0, Math.min(wanted, span));
  ask();
}

// --- hands ----------------------------------------------------------------------------------------------------------

const fingers = new Map();
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, event);
});
for (const end of ["pointerup", "pointercancel"]) {
  canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
}
canvas.addEventListener("pointermove", (event) => {
  const old = fingers.get(event.pointerId);
  if (!old) return;
  const dx = event.clientX - old.clientX, dy = event.clientY - old.clientY;
  if (fingers.size === 2) {
    const other = [...fingers.values()].find((finger) => finger.pointerId !== event.pointerId);
    const gap = (a) => Math.hypot(a.clientX - other.clientX, a.clientY - other.clientY) || 1;
    zoom(gap(event) / gap(old));
    pan(dx / 2, dy / 2);
  } else if (event.shiftKey || event.buttons === 4) {
    pan(dx, dy);
  } else {
    view.azimuth -= 0.008 * dx;
    view.elevation = Math.max(-1.55, Math.min(1.55, view.elevation + 0.008 * dy));
  }
  fingers.set(event.pointerId, event);
  ask();
});
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(Math.exp(-0.0012 * event.deltaY));
}, { passive: false });

function zoom(factor) {
  view.zoom = Math.max(0.1, Math.min(40, view.zoom * factor));
  ask();
}

function pan(dx, dy) {
  const [right, up] = camera(), s = size / (0.92 * view.zoom * Math.min(width, height - 130));
  view.centre = view.centre.map((x, c) => x - s * (dx * right[c] - dy * up[c]));
}

function reset() {
  view = home();
  ask();
}
canvas.addEventListener("dblclick", reset);
byId("reset").addEventListener("click", reset);
byId("play").addEventListener("click", () => setPlaying(!playing));
slider.addEventListener("input", () => { setPlaying(false); moveTo((Number(slider.value) / Math.max(K - 1, 1)) * span); });
for (const id of ["traces", "axes"]) byId(id).addEventListener("change", ask);
byId("controls").addEventListener("submit", (event) => event.preventDefault());
document.addEventListener("keydown", (event) => {
  if (event.key === " " && event.target.tagName !== "BUTTON") { event.preventDefault(); setPlaying(!playing); }
  const steps = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (steps && event.target === document.body) moveTo(seconds + (steps * span) / Math.max(K - 1, 1));
});

function fit() {
  width = innerWidth;
  height = innerHeight;
  canvas.width = width * devicePixelRatio;
  canvas.height = height * devicePixelRatio;
  readColors();
  ask();
}
addEventListener("resize", fit);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", fit);

document.title = motion.title;
byId("title").textContent = motion.title;
const entries = frames.filter((frame) => frame.sensor).map((frame) => [frame.name, "sensor"])
  .concat(motion.markers.map((m) => [m.name, "marker"]));
for (const [name, kind] of entries) {
  const item = document.createElement("li");
  item.textContent = name;
  item.style.setProperty("--dot", `var(--${kind})`);
  byId("legend").append(item);
}
slider.max = String(K - 1);
fit();

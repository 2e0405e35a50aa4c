// Plays the motions of the page's block #motion in the view of renderer.js: poses of frames over time.
// Names are only ever set as text.
const motion = JSON.parse(document.getElementById("motion").textContent);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const byId = (id) => document.getElementById(id);
const scene = motion.scene, K = motion.times, slider = byId("time");
scene.meshes.forEach((mesh) => {
  mesh.vertices = new Float32Array(bytes(mesh.vertices));
  mesh.faces = new Uint32Array(bytes(mesh.faces));
});
const courses = motion.courses.map((course, m) => ({
  frames: scene.mechanisms[m].frames,
  places: new Float32Array(bytes(course.places)), // [time][frame][x, y, z]
  turns: new Int16Array(bytes(course.turns)), // [time][frame][x, y, z, w], unit quaternions times 32767
  arrows: course.arrows.map((arrow) => ({ ...arrow, values: new Float32Array(bytes(arrow.values)) })), // [time][x, y, z]
  shown: course.shown, // [start, end): the times at which it is seen; null: always
  p: null, R: null, traces: [],
}));
const view = createRenderer(byId("scene"), scene);

// --- poses ----------------------------------------------------------------------------------------------------------

function turn(course, f, a, b, s, out) { // between two quaternions, the shorter way
  const F = course.frames.length, i = 4 * (a * F + f), j = 4 * (b * F + f), q = course.turns;
  let scalar = 0;
  for (let c = 0; c < 4; c++) scalar += q[i + c] * q[j + c];
  const sign = scalar < 0 ? -1 : 1, v = [0, 1, 2, 3].map((c) => (1 - s) * q[i + c] + sign * s * q[j + c]);
  const length = Math.hypot(...v) || 1, [x, y, z, w] = v.map((x) => x / length);
  out.set([
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y),
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x),
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y),
  ], 9 * f);
}

function pose(course, k) { // at a picture's number, which may lie between two
  const F = course.frames.length, a = Math.min(Math.floor(k), K - 1), b = Math.min(a + 1, K - 1), s = k - a;
  course.p = new Float64Array(3 * F);
  course.R = new Float64Array(9 * F);
  const [one, other] = [a, b].map((i) => 3 * i * F);
  for (let i = 0; i < 3 * F; i++) course.p[i] = course.places[one + i] + s * (course.places[other + i] - course.places[one + i]);
  for (let f = 0; f < F; f++) turn(course, f, a, b, s, course.R);
}

function list(course, k) { // the arrows at a picture
  const i = 3 * Math.min(Math.round(k), K - 1), { p, R } = course;
  return course.arrows.map(({ kind, frame, at, base, scale, values }) => {
    const local = [0, 1, 2].map((c) => scale * values[i + c]);
    const turned = (v) => (frame < 0 ? v : [0, 1, 2].map((r) => R[9 * frame + r] * v[0] + R[9 * frame + 3 + r] * v[1] + R[9 * frame + 6 + r] * v[2]));
    const foot = turned(at).map((x, c) => x + (frame < 0 ? 0 : p[3 * frame + c]));
    return { kind, at: foot, vector: base ? local : turned(local) };
  });
}

for (const course of courses) course.frames.forEach((frame, f) => {
  if (!frame.sensor) return;
  const points = new Float32Array(3 * K), F = course.frames.length;
  for (let k = 0; k < K; k++) points.set(course.places.subarray(3 * (k * F + f), 3 * (k * F + f) + 3), 3 * k);
  course.traces.push([`${f} ${frame.name}`, points]);
});

function showPoses() {
  const k = now(), time = motion.start + seconds + 1e-9;
  courses.forEach((course, m) => {
    const seen = !course.shown || (course.shown[0] <= time && time < course.shown[1]);
    view.setShown(m, seen);
    if (!seen) return;
    pose(course, k);
    view.setPose(m, course.p, course.R);
    view.setArrows(m, list(course, k));
    for (const [name, points] of course.traces) view.setTrace(m, name, points, Math.floor(k));
  });
}

// --- time -----------------------------------------------------------------------------------------------------------

let seconds = 0, playing = false, before = 0, asked = false;
const span = motion.end - motion.start;
const now = () => (span > 0 ? Math.min((seconds / span) * (K - 1), K - 1) : 0);

function show() {
  const time = motion.start + seconds, part = motion.parts.filter((x) => x.start <= time + 1e-9).pop();
  slider.value = String(Math.round(now()));
  byId("clock").textContent = `${time.toFixed(2)} / ${motion.end.toFixed(2)} s`;
  byId("part").textContent = part ? part.name : "";
  if (view) showPoses();
}

function ask() { // to show, at the next refresh of the screen
  if (!asked) requestAnimationFrame(tick);
  asked = true;
}

function tick(at) {
  asked = false;
  if (playing) {
    seconds += (Math.min(Math.max(at - before, 0), 100) / 1000) * Number(byId("speed").value);
    if (seconds >= span) {
      seconds = byId("loop").checked ? 0 : span;
      if (!byId("loop").checked) setPlaying(false);
    }
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

byId("reset").addEventListener("click", () => view && view.reset());
byId("play").addEventListener("click", () => setPlaying(!playing));
slider.addEventListener("input", () => { setPlaying(false); moveTo((Number(slider.value) / Math.max(K - 1, 1)) * span); });
for (const box of document.querySelectorAll("[data-switch]")) {
  const names = box.dataset.switch.split(" ");
  const solids = scene.mechanisms.flatMap((m) => m.solids);
  const needed = { arrows: courses.some((x) => x.arrows.length), apart: courses.length > 1 && !motion.sequence,
    meshes: solids.some((x) => x.layer === "meshes"), contacts: solids.some((x) => x.layer === "contacts"),
    solids: solids.some((x) => x.layer === "solids"), traces: courses.some((x) => x.traces.length) };
  box.parentElement.hidden = needed[names[0]] === false;
  const change = () => {
    if (!view) return;
    for (const name of names) view.options[name] = box.checked;
    if (names[0] === "apart") view.reset();
    view.draw();
  };
  box.checked = motion.options[names[0]] ?? box.checked;
  box.addEventListener("change", change);
  change();
}
byId("controls").addEventListener("submit", (event) => event.preventDefault());
document.addEventListener("keydown", (event) => {
  if (event.key === " " && !["BUTTON", "INPUT", "SUMMARY"].includes(event.target.tagName)) { event.preventDefault(); setPlaying(!playing); }
  const steps = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (steps && event.target === document.body) moveTo(seconds + (steps * span) / Math.max(K - 1, 1));
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view && view.draw());

document.title = motion.title;
byId("title").textContent = motion.title;
const several = scene.mechanisms.length > 1 && !motion.sequence;
const sensors = new Set(scene.mechanisms.flatMap((m) => m.frames.filter((frame) => frame.sensor).map((frame) => frame.name)));
const entries = several ? scene.mechanisms.map((m) => [m.name, m.color]) : [...sensors].map((name) => [name, "var(--sensor)"]);
for (const [name, color] of entries.concat(scene.markers.map((m) => [m.name, "var(--marker)"]))) {
  const item = document.createElement("li");
  item.textContent = name;
  item.style.setProperty("--dot", color);
  byId("legend").append(item);
}
byId("none").hidden = Boolean(view);
slider.max = String(K - 1);
show();

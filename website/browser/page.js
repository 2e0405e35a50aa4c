// The page that generates in a browser: an editor on the left, what `mbsrun playground` shows on the right.
// The first mechanism was made when the site was built; a worker loads Python meanwhile. Names are only set as text.
const byId = (id) => document.getElementById(id);
const [THINNEST, LARGEST] = [0.03, 0.5]; // of an edge of a solid, relative to the size of the mechanism
const template = fetch("mechanism.html").then((found) => found.text());
const worker = new Worker("worker.js", { type: "module" });
let asked = 0, answered = 0;

function say(text, bad = false) {
  byId("state").textContent = text;
  byId("state").classList.toggle("bad", bad);
}

async function measure(machine, picture) { // the bounds of the frames over poses of the coordinates' ranges
  const model = await loadModel(machine), low = [0, 0, 0], high = [0, 0, 0];
  for (let k = 0; k < 60; k++) {
    const q = machine.start.map((x, i) => {
      const { lower, upper } = machine.positions[i];
      return k && !machine.quaternions.length ? lower + (upper - lower) * ((0.618034 * k * (i + 1)) % 1) : x;
    });
    model.set("coordinate", q);
    const { p, R } = model.call("frames");
    const ends = [...picture.ends, ...picture.solids].filter(({ frame }) => frame >= 0);
    const points = picture.frames.map((_, f) => [0, 1, 2].map((c) => p[3 * f + c]));
    for (const { frame: f, at } of ends) {
      points.push([0, 1, 2].map((c) => p[3 * f + c] + at.reduce((sum, x, j) => sum + R[9 * f + 3 * j + c] * x, 0)));
    }
    for (const point of points) for (let c = 0; c < 3; c++) {
      low[c] = Math.min(low[c], point[c]);
      high[c] = Math.max(high[c], point[c]);
    }
  }
  return { low, high };
}

async function arrange(machine, picture) { // what renderer.js draws
  const { low, high } = await measure(machine, picture);
  const size = Math.hypot(...high.map((x, c) => x - low[c])) / 2 || 1;
  for (let c = 0; c < 3; c++) {
    const missing = Math.max(0.1 * size - (high[c] - low[c]), 0) / 2;
    [low[c], high[c]] = [low[c] - missing, high[c] + missing];
  }
  const limit = (x) => Math.min(Math.max(x, THINNEST * size), LARGEST * size);
  const floor = picture.up.reduce((sum, x, c) => sum + Math.min(x * low[c], x * high[c]), 0);
  return {
    up: picture.up,
    bounds: { low, high },
    thickness: 0.012 * size,
    planes: [{ at: picture.up.map((x) => floor * x), normal: picture.up, grid: true }],
    markers: [],
    meshes: [],
    mechanisms: [{
      name: machine.name,
      color: "#5d6b7a",
      frames: [...picture.frames],
      solids: picture.solids.map((solid) => ({ ...solid, size: solid.size.map(limit) })),
      lines: [],
    }],
  };
}

async function show({ machine, picture, report, equations, remarks = [] }) {
  const content = { machine, controllers: [], scene: await arrange(machine, picture), added: picture.ends };
  const safe = JSON.stringify(content).replace(/[<>&\u2028\u2029]/g, (c) => `\\u${c.charCodeAt(0).toString(16).padStart(4, "0")}`);
  const page = (await template).split("@CONTENT@");
  byId("mechanism").srcdoc = page[0] + safe + page[1];
  byId("equations").srcdoc = equations;
  byId("report").textContent = report;
  byId("remarks").textContent = remarks.join("\n");
}

byId("mechanism").addEventListener("load", () => { // begin to move, at a push
  const inner = byId("mechanism").contentDocument, isChanged = Boolean(byId("mechanism").srcdoc);
  if (!isChanged && !byId("mechanism").getAttribute("src")) return;
  const begin = () => {
    if (inner !== byId("mechanism").contentDocument) return;
    if (!inner.documentElement.dataset.ready) { setTimeout(begin, 20); return; }
    for (let k = 0; isChanged && k < 4; k++) inner.getElementById("push").click();
    inner.getElementById("run").click();
    document.documentElement.dataset.moving = inner.title;
  };
  begin();
});

worker.onmessage = async ({ data }) => {
  if (data.ready) {
    document.documentElement.dataset.python = "ready";
    byId("apply").disabled = false;
    say("Python is here. Change the model, and generate.");
    return;
  }
  answered = data.number;
  if (answered !== asked) return; // a newer text is on its way
  byId("apply").disabled = false;
  const found = data.failure ? { faults: [`The generator failed: ${data.failure}`] } : JSON.parse(data.answer);
  byId("faults").textContent = (found.faults || []).join("\n");
  document.documentElement.dataset.answered = String(answered);
  if (found.faults) { say("The model has faults; the mechanism shown is the one before.", true); return; }
  say(`Generated in ${((performance.now() - data.asked) / 1000).toFixed(1)} s.`);
  await show(found);
};
worker.onerror = (event) => say(`Python did not load: ${event.message}`, true);

byId("apply").addEventListener("click", () => {
  byId("apply").disabled = true;
  say("Generating …");
  worker.postMessage({ number: ++asked, text: byId("model").value, asked: performance.now() });
});
byId("model").addEventListener("keydown", (event) => {
  if ((event.ctrlKey || event.metaKey) && event.key === "Enter") byId("apply").click();
});

byId("swing").addEventListener("click", () => {
  byId("mechanism").removeAttribute("srcdoc");
  byId("mechanism").src = "swing_up.html";
  byId("equations").srcdoc = byId("report").textContent = "";
  say("The solver runs in this page: it plans the swing-up of a cart-pole, and plans anew in each period.");
});

say("The double pendulum was generated before; Python loads, for changes.");
fetch("first.json").then((found) => found.json()).then(async (first) => {
  byId("model").value = first.text;
  byId("swing").hidden = !first.swings;
  await show(first);
});

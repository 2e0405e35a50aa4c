// The page that generates in a browser: an editor on the left, what `mbsrun playground` shows on the right.
// The first mechanism was made when the site was built; a worker loads Python meanwhile. Names are only set as text.
const byId = (id) => document.getElementById(id);
const [THINNEST, LARGEST, BALL, DRUM] = [0.024, 0.5, 0.12, [0.034, 0.034, 0.05]]; // relative to the size of the mechanism
const ASKED = 1e-6; // the accuracy of the advice
const TITLES = { impl: "forces of a motion, by recursion", semi: "mass matrix and bias",
  exp1: "accelerations, by elimination in M", exp2: "accelerations, by articulated bodies" };
const template = fetch("mechanism.html").then((found) => found.text());
const methods = fetch("methods.json").then((found) => found.json());
const worker = new Worker("worker.js", { type: "module" });
let asked = 0, answered = 0, isHere = false, waiting = null, measuring = null, measured = null; // fronts: see measure

function say(text, bad = false) {
  byId("state").textContent = text;
  byId("state").classList.toggle("bad", bad);
}

async function bound(machine, picture) { // the bounds of the frames over poses of the coordinates' ranges
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
  const { low, high } = await bound(machine, picture);
  const size = Math.hypot(...high.map((x, c) => x - low[c])) / 2 || 1;
  for (let c = 0; c < 3; c++) {
    const missing = Math.max(0.1 * size - (high[c] - low[c]), 0) / 2;
    [low[c], high[c]] = [low[c] - missing, high[c] + missing];
  }
  const limit = (x) => Math.min(Math.max(x, THINNEST * size), LARGEST * size);
  const resize = (solid) => {
    if (solid.ball) return solid.size.map((share) => BALL * size * share);
    if (solid.layer === "joints") return DRUM.map((share) => size * share);
    if (solid.layer === "contacts") return solid.size.map((x) => Math.max(x, 0.018 * size));
    return solid.layer === "solids" ? solid.size.map(limit) : solid.size;
  };
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
      solids: picture.solids.map((solid) => ({ ...solid, size: resize(solid) })),
      lines: picture.lines,
    }],
  };
}

async function show({ machine, picture, costs, report, equations, remarks = [] }) {
  const content = { machine, controllers: [], scene: await arrange(machine, picture), added: picture.ends };
  const safe = JSON.stringify(content).replace(/[<>&\u2028\u2029]/g, (c) => `\\u${c.charCodeAt(0).toString(16).padStart(4, "0")}`);
  const page = (await template).split("@CONTENT@");
  byId("mechanism").srcdoc = page[0] + safe + page[1];
  byId("equations").srcdoc = equations;
  byId("report").textContent = report;
  byId("remarks").textContent = remarks.join("\n");
  compare(machine, costs);
}

// --- the table and the front -----------------------------------------------------------------------------------------

function list(costs, rates = {}) { // the formulations, with flops and times
  const rows = [["", "", "flops", "equations", "time here"]];
  for (const { name, flops, equations } of costs) {
    rows.push([name.toUpperCase(), TITLES[name], flops, equations, rates[name] ? writeTime(rates[name]) : "–"]);
  }
  byId("costs").replaceChildren(...rows.map((cells, r) => {
    const row = document.createElement("tr");
    row.append(...cells.map((text) => Object.assign(document.createElement(r ? "td" : "th"), { textContent: text })));
    return row;
  }));
}

function compare(machine, costs) { // measures once Python is here, since a measurement needs a quiet machine
  if (measuring) measuring.terminate();
  measuring = measured = null;
  waiting = { machine, costs };
  list(costs);
  byId("made").hidden = false;
  byId("finding").textContent = isHere ? "It is being measured …" : "It is measured once Python is here.";
  byId("choice").textContent = "";
  byId("chart").replaceChildren();
  byId("chart").removeAttribute("height");
  delete document.documentElement.dataset.measured;
  if (isHere) measure();
}

async function measure() {
  if (!waiting) return;
  const { machine, costs } = waiting, own = new Worker("front-worker.js");
  waiting = null;
  measuring = own;
  own.onmessage = ({ data }) => {
    own.terminate();
    if (measuring !== own) return;
    measuring = null;
    if (data.failure) byId("finding").textContent = `Nothing was measured: ${data.failure}`;
    else {
      list(costs, data.rates);
      measured = data;
      draw();
    }
    document.documentElement.dataset.measured = machine.name;
  };
  own.postMessage({ machine, methods: await methods });
}

function draw() {
  if (!measured) return;
  const { dots, floor } = measured, choice = findChoice(dots, ASKED);
  byId("finding").textContent = stateFinding(dots, floor);
  byId("choice").textContent = choice
    ? `◉ For errors up to ${writeError(ASKED)}: ${choice.line}, ${choice.setting}, ${writeTime(choice.work)}.`
    : `No measured setting has errors up to ${writeError(ASKED)}.`;
  drawFront(byId("chart"), measured, ASKED, byId("chart").clientWidth || 360);
}
addEventListener("resize", draw);

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
    isHere = true;
    measure();
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
  byId("made").hidden = true;
  say("The solver runs in this page: it plans the swing-up of a cart-pole, and plans anew in each period.");
});

say("The double pendulum was generated before; Python loads, for changes.");
fetch("first.json").then((found) => found.json()).then(async (first) => {
  byId("model").value = first.text;
  byId("swing").hidden = !first.swings;
  await show(first);
});

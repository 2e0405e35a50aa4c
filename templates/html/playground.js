// Moves the mechanism of the page's block #content: sliders, tables, simulation and controllers around `kernels.js`.
// Names are only ever set as text.
(async () => {
  const { machine, controllers, scene, added } = JSON.parse(document.getElementById("content").textContent);
  const byId = (id) => document.getElementById(id);
  const n = machine.joints.length, actuated = machine.joints.map((_, i) => i).filter((i) => machine.joints[i].actuated);
  const model = await loadModel(machine);
  for (const mesh of scene.meshes) {
    mesh.vertices = new Float32Array(decode(mesh.vertices).buffer);
    mesh.faces = new Uint32Array(decode(mesh.faces).buffer);
  }
  const view = createRenderer(byId("scene"), scene);
  const say = (text) => { byId("note").textContent = text; };
  const show = (x) => (!Number.isFinite(x) ? "–" : Math.abs(x) >= 1e5 || (x && Math.abs(x) < 1e-4) ? x.toExponential(3) : x.toFixed(4));

  // --- rows of sliders ----------------------------------------------------------------------------------------------

  function showShort(x) { // five digits, in at most eleven characters
    const size = Math.abs(x);
    return size !== 0 && (size < 1e-3 || size >= 1e7) ? x.toExponential(4) : String(Number(x.toPrecision(5)));
  }

  function addRow(place, { name, unit, lower, upper, value, follows = false }, changed) { // a slider beside a number; returns its setter
    const row = document.createElement("div"), [label, suffix] = ["span", "span"].map((tag) => document.createElement(tag));
    const slider = document.createElement("input"), number = document.createElement("input");
    row.className = "row";
    label.textContent = name;
    suffix.textContent = unit;
    Object.assign(slider, { type: "range", min: lower, max: upper, step: (upper - lower) / 1000 || 1e-3 });
    Object.assign(number, { type: "number", step: "any" });
    for (const input of [slider, number]) {
      input.setAttribute("aria-label", `${place} of ${name}`);
      if (follows) Object.assign(input, { disabled: true, title: "The loops determine it." });
    }
    const put = (x) => {
      if (x < Number(slider.min)) slider.min = x;
      if (x > Number(slider.max)) slider.max = x;
      slider.value = x;
      if (document.activeElement !== number) number.value = showShort(x);
    };
    slider.addEventListener("input", () => { number.value = showShort(Number(slider.value)); changed(Number(slider.value)); });
    number.addEventListener("change", () => {
      const x = Number(number.value);
      if (number.value !== "" && Number.isFinite(x)) { number.blur(); put(x); changed(x); }
    });
    row.append(label, slider, number, suffix);
    byId(place).append(row);
    put(value);
    return put;
  }

  const looped = machine.loops.length > 0;
  const ruling = looped ? machine.independent : machine.joints.map((_, i) => i); // joints that determine the others
  const leads = (i) => !looped || machine.quaternions.length > 0 || ruling.includes(i); // whether a coordinate has a slider

  const change = (role, index) => (x) => {
    const values = model.get(role), kept = values.slice();
    values[index] = x;
    say(put(role, values, kept, index));
    if (role === "coordinate" || role === "velocity") began = null;
    refresh();
  };

  function put(role, values, kept, index) { // sets an array, and closes the loops; returns a complaint, or ""
    if (role === "coordinate" && !machine.quaternions.length) {
      return model.move(index, values[index]) ? "" : `it moves no further: ${model.explain()}`;
    }
    if (role === "coordinate") normalise(values);
    if (model.set(role, values)) return "these parameters are out of the range that the functions accept";
    if (role === "velocity" || role === "coordinate" || role === "parameter" || role === "design") {
      if ((role === "velocity" || model.close()) && model.complete()) return "";
      model.set(role, kept);
      model.complete();
      return `the change is undone: ${model.explain()}`;
    }
    return "";
  }

  function normalise(q) { // quaternions, each of four entries
    for (const first of machine.quaternions) {
      const length = Math.hypot(...q.subarray(first, first + 4));
      if (length > 0) for (let k = 0; k < 4; k++) q[first + k] /= length;
      else q[first + 3] = 1;
    }
  }

  function nice(x) { // the next larger number of 1, 2, 5, 10, ...
    const power = 10 ** Math.floor(Math.log10(x || 1));
    return power * [1, 2, 5, 10].find((k) => k * power >= x * 0.999);
  }

  function findReach() { // of inputs: twice the forces at rest in some poses, and a few accelerations
    const q = model.get("coordinate"), most = new Float64Array(n);
    if (looped) {
      const [rest, , mass] = inverse();
      ruling.forEach((i, k) => { most[i] = rest && mass ? 2 * Math.abs(rest[k]) + 5 * mass[k * ruling.length + k] : 0; });
      return [...most].map((x) => nice(x || Math.max(...most)));
    }
    for (let k = 0; k < 12; k++) {
      const spread = machine.positions.map((p, i) => p.lower + (p.upper - p.lower) * ((0.618034 * (k + 1) * (i + 1)) % 1));
      normalise(Object.assign(spread, { subarray: Array.prototype.slice }));
      model.set("coordinate", spread);
      const rest = model.call("impl"), mass = model.call("semi");
      if (rest && mass) for (let i = 0; i < n; i++) most[i] = Math.max(most[i], 2 * Math.abs(rest.Phi[i]) + 5 * mass.M[i * n + i]);
    }
    model.set("coordinate", q);
    return [...most].map(nice);
  }

  const rows = { coordinate: [], velocity: [], acceleration: [], force: [], drive: [] };
  const reach = findReach();
  machine.positions.forEach((p, i) => rows.coordinate.push(
    addRow("coordinates", { ...p, value: machine.start[i], follows: !leads(i) }, change("coordinate", i))));
  machine.joints.forEach((joint, i) => {
    const speed = joint.speed || 5;
    const { name, unit } = joint;
    const follows = !ruling.includes(i);
    rows.velocity.push(
      addRow("velocities", { name, unit: `${unit}/s`, lower: -speed, upper: speed, value: 0, follows }, change("velocity", i)));
    if (!follows) rows.acceleration.push(
      addRow("accelerations", { name, unit: `${unit}/s²`, lower: -10, upper: 10, value: 0 }, change("acceleration", i)));
  });
  actuated.forEach((i, k) => {
    const { name, force: unit, strength } = machine.joints[i], most = strength || reach[i];
    rows.force.push(addRow("inputs", { name, unit, lower: -most, upper: most, value: 0 }, change("force", k)));
  });
  machine.driven.forEach((i, k) => {
    const { name, unit } = machine.joints[i];
    rows.drive.push(addRow("inputs",
      { name: `${name} (driven)`, unit: `${unit}/s²`, lower: -10, upper: 10, value: 0 }, change("drive", k)));
  });
  for (const [role, listed] of [["parameter", machine.parameters], ["design", machine.design]]) {
    listed.forEach(({ name, value }, i) => addRow("parameters",
      { name, unit: "", lower: Math.min(0, 2 * value), upper: Math.max(2 * value, value ? 0 : 1), value }, change(role, i)));
  }
  byId("inputs-part").hidden = !(actuated.length + machine.driven.length);
  byId("loops-note").hidden = !looped;
  byId("parameters-part").hidden = !(machine.parameters.length + machine.design.length);

  // --- tables -------------------------------------------------------------------------------------------------------

  function fill(id, heads, lines) {
    const table = byId(id), rowsOf = [heads, ...lines];
    while (table.rows.length > rowsOf.length) table.deleteRow(-1);
    rowsOf.forEach((cells, r) => {
      const row = table.rows[r] || table.insertRow();
      cells.forEach((text, c) => {
        const cell = row.cells[c] || row.appendChild(document.createElement(r ? "td" : "th"));
        if (cell.textContent !== text) cell.textContent = text;
      });
    });
  }

  function inverse() {
    const kept = model.get("force"), qdd = model.get("acceleration");
    model.set("force", new Float64Array(kept.length));
    if (looped) {
      const v = model.get("velocity");
      model.set("independent_velocity", ruling.map((i) => v[i]));
      model.set("independent_acceleration", ruling.map((i) => qdd[i]));
    }
    const [impl, semi] = ["impl", "semi"].map((name) => model.call(looped ? `${name}_red` : name));
    model.set("force", kept);
    const sum = semi && ruling.map((_, i) => ruling.reduce((s, at, j) => s + semi.M[j * ruling.length + i] * qdd[at], semi.c[i]));
    return [impl && impl.Phi, sum, semi && semi.M];
  }

  function tables() {
    const [impl, semi, M] = inverse(), [exp1, exp2] = ["exp1", "exp2"].map((name) => model.call(name));
    const at = (values, i) => (values ? show(values[i]) : "fails");
    fill("inverse", ["joint", "IMPL", "SEMI", ""], ruling.map((joint, i) =>
      [machine.joints[joint].name, at(impl, i), at(semi, i), machine.joints[joint].force]));
    const forward = (name, result, i, unit) => [name, at(exp1 && exp1[result], i), at(exp2 && exp2[result], i), unit];
    fill("forward", ["joint", "EXP1", "EXP2", ""], [
      ...machine.joints.map((joint, i) => forward(joint.name, "qdd", i, `${joint.unit}/s²`)),
      ...machine.driven.map((i, k) => forward(`force of ${machine.joints[i].name}`, "tau", k, machine.joints[i].force)),
      ...machine.equations.map((name, i) => forward(`force of loop ${name}`, "lam", i, "")),
    ]);
    const names = ruling.map((i) => machine.joints[i].name);
    fill("mass", ["", ...names], names.map((name, i) => [name, ...names.map((_, j) => (M ? show(M[j * names.length + i]) : "fails"))]));
    const found = energies();
    const lines = [["kinetic", show(found.T)], ["potential", show(found.V)], ["sum", show(found.T + found.V)]];
    lines.push(["change since the start", began === null ? "–" : (found.T + found.V - began).toExponential(2)]);
    fill("energy", ["energy", "J"], lines);
  }

  function energies() {
    const found = model.call("energy");
    const [T, V] = machine.functions.energy.results.map((result) => result.name).slice(0, 2).map((name) => found[name][0]);
    return { T, V };
  }

  const kinds = ["add", "mul", "div", "sqrt", "trig"];
  const rates = {};
  function costs() {
    const listed = Object.entries(machine.functions);
    fill("costs", ["function", "all", ...kinds, "calls/s"], listed.map(([name, { flops }]) =>
      [name, String(flops.paper), ...kinds.map((kind) => String(flops[kind])), rates[name] ? show(rates[name]) : "–"]));
  }

  function measure() {
    for (const name of Object.keys(machine.functions)) {
      let count = 0;
      const begin = performance.now();
      while (performance.now() - begin < 60) for (let k = 0; k < 50; k++, count++) model.run(name);
      rates[name] = Math.round(1000 * count / (performance.now() - begin));
    }
    costs();
  }

  // --- picture ------------------------------------------------------------------------------------------------------

  function draw() {
    if (!view) return;
    const { p, R } = model.call("frames"), origins = [...p], axes = [...R];
    for (const { frame, at } of added) { // fixed in a frame; -1 is the base
      const turn = frame < 0 ? [1, 0, 0, 0, 1, 0, 0, 0, 1] : axes.slice(9 * frame, 9 * frame + 9);
      for (let c = 0; c < 3; c++) {
        origins.push((frame < 0 ? 0 : origins[3 * frame + c]) + turn[c] * at[0] + turn[3 + c] * at[1] + turn[6 + c] * at[2]);
      }
      axes.push(...turn);
    }
    view.setPose(0, Float64Array.from(origins), Float64Array.from(axes));
  }

  function refresh() {
    for (const role of ["coordinate", "velocity", "force", "drive"]) model.get(role).forEach((x, i) => rows[role][i](x));
    byId("clock").textContent = `${seconds.toFixed(2)} s`;
    tables();
    draw();
  }

  // --- controllers --------------------------------------------------------------------------------------------------

  const loaded = new Map(); // the generated controllers that were chosen
  let due = 0, isPlanned = false; // time of the next sampling, and whether there is a plan

  const wrap = (x, turns) => (turns ? x - 2 * Math.PI * Math.round(x / (2 * Math.PI)) : x);
  const drives = [
    ["sliders", () => null],
    ...(actuated.every((i) => ruling.includes(i)) ? [["hold against gravity", () => { // inverse dynamics at rest
      const [kept, v, a] = ["force", "velocity", "acceleration"].map((role) => [role, model.get(role)]);
      for (const [role, values] of [kept, v, a]) model.set(role, new Float64Array(values.length));
      const [found] = inverse();
      for (const [role, values] of [kept, v, a]) model.set(role, values);
      return found && actuated.map((i) => found[ruling.indexOf(i)]);
    }]] : []),
    ...controllers.map((each) => [each.name, each.kind === "regulator" ? () => regulate(each) : () => predict(each)]),
  ];
  drives.forEach(([name], i) => byId("drive").append(new Option(name, String(i))));
  if (controllers.length) byId("drive").value = String(drives.length - controllers.length);

  function regulate({ pose, inputs, joints, gains }) {
    const q = model.get("coordinate"), v = model.get("velocity");
    const x = [...joints.map((i) => wrap(q[i] - pose[i], machine.positions[i].turns)), ...joints.map((i) => v[i])];
    return inputs.map((u, k) => u - gains[k].reduce((sum, gain, i) => sum + gain * x[i], 0));
  }

  function predict(told) { // new inputs once in each sampling period
    const controller = loaded.get(told);
    if (!controller || seconds < due - 1e-9) return null;
    const q = model.get("coordinate"), v = model.get("velocity");
    if (!isPlanned) {
      const status = controller.solve(q, v);
      if (status > 1) say(`no plan: ${controller.explain(status)}`);
    }
    const { status, inputs } = controller.control(q, v, isPlanned);
    if (status !== 10) say(`the kept plan is applied: ${controller.explain(status)}`);
    isPlanned = true;
    due = seconds + controller.period();
    return inputs;
  }

  byId("drive").addEventListener("change", async () => {
    const told = controllers[Number(byId("drive").value) - (drives.length - controllers.length)];
    say("");
    isPlanned = false;
    due = seconds;
    if (told && told.kind === "controller" && !loaded.has(told)) loaded.set(told, await loadController(told));
  });

  // --- simulation ---------------------------------------------------------------------------------------------------

  let seconds = 0, running = false, before = 0, began = null, owed = 0;

  function advance(duration) { // simulate; returns whether it can go on
    const h = Number(byId("step").value), form = byId("form").value;
    for (owed += duration; owed >= h; owed -= h) {
      const u = drives[Number(byId("drive").value)][1]();
      if (u) model.set("force", u);
      if (!model.step(form, h)) {
        say(`${model.explain()}: reset, or take a shorter step`);
        owed = 0;
        return false;
      }
      seconds += h;
    }
    return true;
  }

  function tick(at) {
    if (!running) return;
    const real = Math.min(Math.max(at - before, 0), 50) / 1000;
    before = at;
    if (!advance(real * Number(byId("speed").value))) setRunning(false);
    refresh();
    requestAnimationFrame(tick);
  }

  function setRunning(wanted) {
    running = wanted;
    byId("run").textContent = running ? "Pause" : "Run";
    if (!running) return;
    say("");
    if (began === null) { const { T, V } = energies(); began = T + V; }
    before = performance.now();
    requestAnimationFrame(tick);
  }

  function reset() {
    setRunning(false);
    model.set("coordinate", machine.start);
    model.close(); // where parameters were changed
    for (const role of ["velocity", "force", "drive"]) model.set(role, new Float64Array(model.get(role).length));
    [seconds, due, owed, began, isPlanned] = [0, 0, 0, null, false];
    say("");
    refresh();
  }

  byId("run").addEventListener("click", () => setRunning(!running));
  byId("drive").dispatchEvent(new Event("change")); // a page with a controller starts with it
  byId("reset").addEventListener("click", reset);
  byId("measure").addEventListener("click", measure);
  byId("push").addEventListener("click", () => {
    const v = model.get("velocity");
    v[ruling[ruling.length - 1]] += 1;
    model.set("velocity", v);
    if (!model.complete()) say(`no push: ${model.explain()}`);
    began = null;
    refresh();
  });
  document.addEventListener("keydown", (event) => {
    if (event.key !== " " || event.target !== document.body) return;
    event.preventDefault();
    setRunning(!running);
  });

  document.title = machine.name;
  byId("title").textContent = machine.name;
  if (!view) say("This browser draws no picture (WebGL 2 is missing); everything else works.");
  costs();
  refresh();
  document.documentElement.dataset.ready = "yes";
  globalThis.playground = { model, advance, refresh, drives }; // for the console
})();

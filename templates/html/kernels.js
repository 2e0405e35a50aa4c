"use strict";
// Calls C that was compiled to WebAssembly: the kernels of a model, and a generated controller.
//
//   const model = await loadModel(data);
//   model.set("coordinate", [0.1, 0.2]);          // one array for each role, which all functions read
//   const { M, c } = model.call("semi");          // results by name, full matrices column by column
//   model.step("exp2", 0.001);                    // the classical Runge-Kutta method, or one of given coefficients
//   model.move(0, 0.3);                           // one coordinate, with the loops closed
//
// Numbers lie in the module's own memory, behind everything that it uses itself. Results are those of the C in double
// precision, without fused multiply-add. Compiled C brings its own functions; a module that was written without a
// compiler imports those that it lacks, other than sine and cosine, from Math.

const decode = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

class Memory { // of a module: places for numbers, handed out once
  constructor(instance) {
    this.memory = instance.exports.memory;
    this.next = Math.ceil(instance.exports.__heap_base.value / 16) * 16;
  }

  take(bytes) {
    const place = this.next;
    this.next = Math.ceil((place + bytes) / 16) * 16;
    const missing = this.next - this.memory.buffer.byteLength;
    if (missing > 0) this.memory.grow(Math.ceil(missing / 65536));
    return place;
  }

  numbers(place, count) { return new Float64Array(this.memory.buffer, place, count); } // valid until memory grows

  words(place, count) { return new Int32Array(this.memory.buffer, place, count); }
}

async function loadModel(data) {
  const { instance } = await WebAssembly.instantiate(decode(data.module), { math: Math });
  const memory = new Memory(instance), places = {}, functions = {};
  for (const [role, size] of Object.entries(data.sizes)) places[role] = memory.take(8 * Math.max(size, 1));
  for (const [name, told] of Object.entries(data.functions)) {
    const results = told.results.map((result) => {
      const count = result.places ? result.places.length : result.rows * result.cols;
      return { ...result, count, at: result.role ? places[result.role] : memory.take(8 * Math.max(count, 1)) };
    });
    functions[name] = { ...told, results, args: memory.take(4 * told.arguments.length), outs: memory.take(4 * results.length) };
  }
  for (const { arguments: roles, results, args, outs } of Object.values(functions)) {
    memory.words(args, roles.length).set(roles.map((role) => places[role]));
    memory.words(outs, results.length).set(results.map((result) => result.at));
  }
  const view = (role) => (role in places ? memory.numbers(places[role], data.sizes[role]) : new Float64Array(0));

  function run(name) { // returns the status: 0, or the joint at which the function fails
    const { symbol, args, outs } = functions[name];
    return instance.exports[symbol](args, outs, 0, 0, 0);
  }

  function read({ rows, cols, places: entries, count, at }) {
    const found = memory.numbers(at, count);
    if (!entries) return found.slice();
    const full = new Float64Array(rows * cols);
    entries.forEach((entry, k) => { full[entry] = found[k]; });
    return full;
  }

  function call(name) { // null where the function fails
    if (run(name)) return null;
    return Object.fromEntries(functions[name].results.map((result) => [result.name, read(result)]));
  }

  // --- closed loops: the independent joints determine the others ---

  const { independent, loops } = data, n = data.joints.length;
  const LONGEST = 0.05, FARTHEST = 0.5; // steps of a coordinate on its way, and of the others meanwhile [rad, m]
  let failed = 0; // the status of the last function that failed

  function explain() { // the reason of the last failure
    if (failed > n && failed <= n + loops.length) return `the loop ${loops[failed - n - 1]} does not close, or is singular here`;
    if (failed > 0 && failed <= n) return `the equations cannot be solved for the joint ${data.joints[failed - 1].name} here`;
    return loops.length ? "the loops do not close here" : "numbers beyond all bounds";
  }

  function complete() { // velocities from those of the independent joints; returns whether loops admit them
    if (!loops.length) return true;
    const v = view("velocity");
    view("independent_velocity").set(independent.map((i) => v[i]));
    failed = run("close_rates");
    if (!failed) v.set(read(functions.close_rates.results[0]));
    return !failed;
  }

  function correct(by) { // the coordinates, by a function; returns whether the loops close without a jump
    const q = view("coordinate");
    failed = run(by);
    if (failed) return false;
    const closed = read(functions[by].results[0]);
    if (!closed.every((x, i) => Math.abs(x - q[i]) <= FARTHEST)) return false;
    q.set(closed);
    return true;
  }

  function close() { // the loops near the coordinates: the independent ones stay, unless the others cannot follow
    return !loops.length || (!data.quaternions.length && correct("close")) || correct("project_plain");
  }

  function place(index, value) { // a coordinate near its own, where the loops are closed; returns whether it gets there
    const q = view("coordinate");
    for (let k = 0; k < 100; k++) { // once, unless the others cannot follow
      q[index] = value;
      if (!close()) return false;
      if (Math.abs(q[index] - value) <= 1e-9) return true;
    }
    return false;
  }

  function move(index, value) { // one coordinate to a value, step by step; returns whether it arrives
    const q = view("coordinate"), from = q[index], v0 = view("velocity").slice();
    const count = loops.length ? Math.max(1, Math.ceil(Math.abs(value - from) / LONGEST)) : 1;
    for (let k = 1; k <= count; k++) {
      const before = q.slice();
      if (place(index, from + (value - from) * k / count)) continue;
      q.set(before);
      complete();
      return false;
    }
    if (complete()) return true;
    view("velocity").set(v0.fill(0));
    return false;
  }

  function project() { // the nearest closed state; returns whether there is one
    failed = run("project_plain");
    if (failed) return false;
    const [q, v] = functions.project_plain.results.map(read);
    view("coordinate").set(q);
    view("velocity").set(v);
    return true;
  }

  function set(role, values) { // returns the status of the set-up that parameters need
    view(role).set(values);
    return role === "parameter" && "setup" in functions ? run("setup") : 0;
  }

  function slope(form) { // rates of coordinates and velocities, or null
    failed = run(form) || ("rates" in functions && run("rates"));
    if (failed) return null;
    const qt = "rates" in functions ? read(functions.rates.results[0]) : view("velocity").slice();
    return [qt, read(functions[form].results[0])];
  }

  const CLASSICAL = { A: [[], [0.5], [0, 0.5], [0, 0, 1]], b: [1 / 6, 1 / 3, 1 / 3, 1 / 6] };

  function step(form, h, { A, b } = CLASSICAL) { // returns whether it could be made; else the state stays
    const q = view("coordinate"), v = view("velocity"), q0 = q.slice(), v0 = v.slice(), rates = [];
    const move = (row) => { // to the start of the step, and on by rates that were computed
      q.set(q0);
      v.set(v0);
      rates.forEach(([qt, a], k) => {
        const length = h * (row[k] || 0);
        if (!length) return;
        for (let i = 0; i < q.length; i++) q[i] += length * qt[i];
        for (let i = 0; i < v.length; i++) v[i] += length * a[i];
      });
    };
    const stay = () => { q.set(q0); v.set(v0); return false; };
    for (const row of A) {
      move(row);
      const found = slope(form);
      if (!found) return stay();
      rates.push(found);
    }
    move(b);
    if (loops.length && !project()) return stay();
    return [...q, ...v].every(Number.isFinite) || stay();
  }

  set("coordinate", data.start);
  set("parameter", data.parameters.map((p) => p.value));
  set("design", data.design.map((p) => p.value));
  return { data, set, get: (role) => view(role).slice(), run, call, step, move, close, complete, explain };
}

async function loadController(data) {
  const { instance } = await WebAssembly.instantiate(decode(data.module), {});
  const memory = new Memory(instance);
  const use = (name, ...given) => instance.exports[`${data.prefix}_${name}`](...given);
  const bytes = use("bytes"), controller = use("create", memory.take(bytes), bytes);
  const state = memory.take(8 * data.states), inputs = memory.take(8 * data.inputs), fields = memory.take(4 * data.fields.length);
  const times = memory.take(8 * (data.intervals + 1)), plan = memory.take(8 * (data.intervals + 1) * data.states);
  const explain = (status) => {
    const at = use("explain", status), all = new Uint8Array(memory.memory.buffer);
    return new TextDecoder().decode(all.slice(at, all.indexOf(0, at)));
  };

  function field(name, count) { // the run-time data of a name
    use("get_data", fields, controller); // a structure of pointers, returned where the first argument points
    return memory.numbers(memory.words(fields, data.fields.length)[data.fields.indexOf(name)], count);
  }

  const choose = (v) => data.velocities.map((i) => v[i]); // of independent joints, where loops determine the others

  return {
    data,
    explain,
    period: () => use("get_period", controller),
    solve(q, v) { // a first plan from a state; returns the status
      field("start_q", q.length).set(q);
      field("start_qd", data.velocities.length).set(choose(v));
      return use("solve", controller, 0);
    },
    control(q, v, shift) { // one sampling period: the status, and the inputs to apply
      use("prepare", controller, shift ? 1 : 0);
      memory.numbers(state, data.states).set([...q, ...choose(v)]);
      const status = use("feedback", controller, state, inputs);
      return { status, inputs: memory.numbers(inputs, data.inputs).slice() };
    },
    plan() { // times, and states at them, row by row
      use("get_plan", controller, times, plan, 0);
      return {
        times: memory.numbers(times, data.intervals + 1).slice(),
        states: memory.numbers(plan, (data.intervals + 1) * data.states).slice(),
      };
    },
  };
}

if (typeof module !== "undefined") module.exports = { loadModel, loadController };

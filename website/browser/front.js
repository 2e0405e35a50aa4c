"use strict";
// Measures error against time of fixed steps on a mechanism, and states the finding as `mbsrun chart` does.
//
//   const { dots, rates, floor, end } = await measureFront(machine, methods);  // dots: {line, setting, work, error}
//   stateFinding(dots, floor);                                            // one sentence, from the numbers
//   findChoice(dots, asked);                                              // the cheapest dot of that accuracy
//
// `chart.js` draws the dots.
//
// The motion begins at the start pose, with 1 as every velocity, and takes 1 s. The work of a dot is the time of the
// whole motion; its error is the largest one of coordinates and velocities at the end. The reference is the method of
// the highest order, with steps that are halved until its end changes no more; its last change is `floor`, and its end `end`.

const DURATION = 1, CHANGES = 30000, PATIENCE = 120; // s; rates of one run at most; ms of one setting at most
const ALIKE = 1.1, DIGIT = 10, USELESS = 0.1;

// --- measurements ----------------------------------------------------------------------------------------------------

function timeCalls(run) { // seconds of a call: the least of a few batches
  let count = 1, least = Infinity;
  for (let batch = 0; batch < 8;) {
    const begin = performance.now();
    for (let k = 0; k < count; k++) run();
    const passed = performance.now() - begin;
    if (passed < 4) { count *= 4; continue; }
    least = Math.min(least, passed / 1000 / count);
    batch++;
  }
  return least;
}

async function measureFront(machine, methods) {
  const model = await loadModel(machine), n = machine.joints.length;
  model.set("velocity", new Float64Array(n).fill(1));
  const rates = {};
  for (const name of ["impl", "semi", "exp1", "exp2"]) if (!model.run(name)) rates[name] = timeCalls(() => model.run(name));
  const form = rates.exp2 <= rates.exp1 || !rates.exp1 ? "exp2" : "exp1";
  if (!rates[form]) return { dots: [], rates, floor: 0, end: null };

  const run = (table, count) => { // the end of the motion, or null
    model.set("coordinate", machine.start);
    model.set("velocity", new Float64Array(n).fill(1));
    for (let k = 0; k < count; k++) if (!model.step(form, DURATION / count, table)) return null;
    return [...model.get("coordinate"), ...model.get("velocity")];
  };
  const compare = (a, b) => a.reduce((most, x, i) => Math.max(most, Math.abs(x - b[i])), 0);
  const best = methods.reduce((a, b) => (b.order > a.order ? b : a));
  let reference = null, floor = Infinity;
  for (let count = 16; count * best.b.length <= CHANGES; count *= 2) {
    const end = run(best, count), change = end && reference ? compare(end, reference) : Infinity;
    if (end && change >= floor && floor < 1e-9) break; // rounding grows from here on
    if (end) [reference, floor] = [end, reference ? Math.min(floor, change) : floor];
  }
  if (!reference) return { dots: [], rates, floor: 0, end: null };

  const dots = [];
  for (const table of methods) {
    let worst = 0;
    for (let count = 4; count * table.b.length <= CHANGES / 2; count *= 2) {
      const end = run(table, count), setting = `${count} steps`, line = `${table.name} on ${form.toUpperCase()}`;
      const error = end && compare(end, reference);
      if (!end || !Number.isFinite(error)) { dots.push({ line, setting, work: null, error: null }); continue; }
      let work = Infinity;
      const begin = performance.now();
      for (let k = 0; k < 3 || (performance.now() - begin < 6 && k < 400); k++) {
        const from = performance.now();
        let passed = 0, repeats = 0;
        do { run(table, count); passed = performance.now() - from; repeats++; } while (passed < 1);
        work = Math.min(work, passed / 1000 / repeats);
        if (performance.now() - begin > PATIENCE) break;
      }
      dots.push({ line, setting, work, error });
      if (error <= 2 * floor || error < 1e-14 || (worst && error > worst)) break;
      worst = error < 1e-9 ? error : 0; // below, rounding ends the line
    }
  }
  return { dots, rates, floor: Number.isFinite(floor) ? floor : 0, end: reference };
}

// --- findings, as in `mbsrun.measuring.fronts` -----------------------------------------------------------------------

const isGood = (dot) => dot.work !== null && dot.error !== null;

function findFront(dots) { // the dots that no other one beats in both, from the cheapest on
  const front = [];
  for (const dot of dots.filter(isGood).sort((a, b) => a.work - b.work || a.error - b.error)) {
    if (!front.length || dot.error < front[front.length - 1].error) front.push(dot);
  }
  return front;
}

function follow(name, front, start, dots) { // the first dot of the front that a line does not match
  const own = dots.filter((dot) => dot.line === name && isGood(dot));
  for (let k = start; k < front.length; k++) {
    const least = Math.min(...own.filter((dot) => dot.error <= DIGIT * front[k].error).map((dot) => dot.work));
    if (least > ALIKE * front[k].work) return k;
  }
  return front.length;
}

function findStretches(dots) { // of errors, from large to small, each with the line that is the fastest there
  const front = findFront(dots), names = [...new Set(dots.filter(isGood).map((dot) => dot.line))], stretches = [];
  for (let start = 0; start < front.length;) {
    const ends = names.map((name) => [follow(name, front, start, dots), name === front[start].line ? 1 : 0, name]);
    const [end, , line] = ends.reduce((a, b) => (b[0] > a[0] || (b[0] === a[0] && b[1] > a[1]) ? b : a));
    stretches.push({ line, largest: start ? front[start - 1].error : Infinity, least: front[end - 1].error });
    start = end;
  }
  return stretches;
}

function writeError(error) { // to one digit
  if (error === 0) return "0";
  const [digits, power] = error.toExponential(0).split("e");
  if (Number(power) >= -2 && Number(power) <= 2) return String(Number(error.toExponential(0)));
  return `${digits}e${Number(power)}`;
}

function locate(stretch, stretches) {
  const isFirst = stretch === stretches[0], isLast = stretch === stretches[stretches.length - 1];
  if (isFirst) return `above ${writeError(stretch.least)}`;
  if (isLast) return `below ${writeError(stretch.largest)}`;
  return `between ${writeError(stretch.largest)} and ${writeError(stretch.least)}`;
}

function stateFinding(dots, floor = 0) {
  const good = dots.filter(isGood).map((dot) => ({ ...dot, error: Math.max(dot.error, floor) }));
  const useful = good.filter((dot) => dot.error <= USELESS), stretches = findStretches(useful.length ? useful : good);
  if (!stretches.length) return "Nothing was measured here.";
  if (stretches.length === 1) return `${stretches[0].line} is the fastest at every error.`;
  const count = ({ largest, least }) => Math.log10(Math.min(largest, USELESS) / Math.max(least, 1e-17));
  const [first, second] = [...stretches].sort((a, b) => count(b) - count(a));
  const begin = locate(first, stretches);
  const text = `${begin[0].toUpperCase()}${begin.slice(1)}, ${first.line} is the fastest`;
  return second.line === first.line ? `${text}.` : `${text}; ${locate(second, stretches)}, ${second.line}.`;
}

function findChoice(dots, asked) {
  const good = dots.filter((dot) => isGood(dot) && dot.error <= asked);
  return good.length ? good.reduce((a, b) => (b.work < a.work ? b : a)) : null;
}

function writeTime(seconds) { // two digits, and the unit that fits
  for (const [size, unit] of [[1, "s"], [1e-3, "ms"], [1e-6, "µs"]]) {
    if (Number(seconds.toPrecision(2)) >= size) return `${Number((seconds / size).toPrecision(2))} ${unit}`;
  }
  return `${Number((seconds * 1e9).toPrecision(2))} ns`;
}

if (typeof module !== "undefined") module.exports = { measureFront, findFront, findChoice, stateFinding, writeError, writeTime };

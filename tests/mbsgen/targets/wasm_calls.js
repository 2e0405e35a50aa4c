// Calls functions of a module: node wasm_calls.js MODULE CALLS.json; prints statuses and the bits of the results.
const fs = require("fs");
const [path, file] = process.argv.slice(2);
(async () => {
  const { instance } = await WebAssembly.instantiate(fs.readFileSync(path), { math: Math });
  const { memory, __heap_base } = instance.exports;
  let next = __heap_base.value;
  const take = (bytes) => {
    const place = (next = Math.ceil(next / 16) * 16);
    next += bytes;
    while (next > memory.buffer.byteLength) memory.grow(1);
    return place;
  };
  const answers = JSON.parse(fs.readFileSync(file, "utf8")).map(({ symbol, inputs, sizes }) => {
    const given = inputs.map((values) => (values ? take(8 * values.length) : 0));
    const found = sizes.map((size) => (size === null ? 0 : take(8 * size)));
    const [args, outs] = [take(4 * given.length), take(4 * found.length)];
    given.forEach((place, k) => place && new Float64Array(memory.buffer, place, inputs[k].length).set(inputs[k]));
    found.forEach((place, k) => place && new Float64Array(memory.buffer, place, sizes[k]).fill(-7));
    new Int32Array(memory.buffer, args, given.length).set(given);
    new Int32Array(memory.buffer, outs, found.length).set(found);
    const status = instance.exports[symbol](args, outs, 0, 0, 0);
    const bits = (place, k) => [...new BigUint64Array(memory.buffer, place, sizes[k])].map((x) => x.toString(16).padStart(16, "0"));
    return { status, results: found.map((place, k) => (place ? bits(place, k) : null)) };
  });
  console.log(JSON.stringify(answers));
})();

// Calls what a page holds: node calls.js kernels.js page.html requests.json; prints the results as JSON.
const fs = require("fs");
const [kernels, page, requests] = process.argv.slice(2);
const { loadModel, loadController } = require(kernels);
const content = JSON.parse(fs.readFileSync(page, "utf8").match(/id="content">(.*?)<\/script>/s)[1]);
const plain = (found) => Object.fromEntries(Object.entries(found).map(([name, values]) => [name, [...values]]));

(async () => {
  const { states, parameters, start, steps, h, moves = [] } = JSON.parse(fs.readFileSync(requests, "utf8"));
  const model = await loadModel(content.machine);
  model.set("parameter", parameters);
  const put = (state) => Object.entries(state).forEach(([role, values]) => model.set(role, values));
  const found = { values: [], motion: [], control: [], moved: [] };
  for (const state of states) {
    put(state);
    const names = Object.keys(content.machine.functions).filter((name) => name !== "setup");
    found.values.push(Object.fromEntries(names.map((name) => [name, plain(model.call(name))])));
  }
  put(start);
  for (let k = 0; k < steps; k++) {
    if (!model.step("exp2", h)) throw new Error(`step ${k} failed`);
    found.motion.push([...model.get("coordinate"), ...model.get("velocity")]);
  }
  for (const [index, value] of moves) {
    found.moved.push({ arrives: model.move(index, value), at: [...model.get("coordinate")], gap: [...model.call("loops").gap] });
  }
  for (const told of content.controllers.filter((each) => start.coordinate && each.kind === "controller")) {
    const controller = await loadController(told);
    const [q, v] = [start.coordinate, start.velocity];
    const status = controller.solve(q, v), message = controller.explain(status);
    const stepped = [0, 1, 2].map((k) => { const { status, inputs } = controller.control(q, v, k > 0); return { status, inputs: [...inputs] }; });
    const { times, states: planned } = controller.plan();
    found.control.push({ status, message, stepped, period: controller.period(), times: [...times], states: [...planned] });
  }
  console.log(JSON.stringify(found));
})();

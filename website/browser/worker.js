// Runs the generator: answers the text of a model with what the page shows of it, as `mbsgen.browser` says.
import { loadPyodide } from "./pyodide/pyodide.mjs";

const archive = fetch("tool.zip").then((found) => found.arrayBuffer());
const python = await loadPyodide({ indexURL: new URL("pyodide/", import.meta.url).href });
python.unpackArchive(await archive, "zip", { extractDir: "/tool" });
python.runPython(`
import sys
sys.path.insert(0, "/tool")
from mbsgen.browser import answer
`);
const answer = python.globals.get("answer");
self.onmessage = ({ data }) => {
  try {
    self.postMessage({ ...data, answer: answer(data.text) });
  } catch (error) {
    self.postMessage({ ...data, failure: String(error.message || error).trim().split("\n").pop() });
  }
};
self.postMessage({ ready: true });

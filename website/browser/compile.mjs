// Compiles a folder of Python to one archive of bytecode, by the Python that will run it:
//   node compile.mjs PYODIDE FOLDER ARCHIVE
import fs from "node:fs";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [pyodide, folder, archive] = process.argv.slice(2);
const { loadPyodide } = await import(pathToFileURL(path.join(pyodide, "pyodide.mjs")).href);
const python = await loadPyodide({ indexURL: `${pyodide}/` });
python.mountNodeFS("/given", folder);
python.runPython(`
import pathlib, py_compile, zipfile
given = pathlib.Path("/given")
with zipfile.ZipFile("/tool.zip", "w", zipfile.ZIP_DEFLATED) as archive:
    for file in sorted(path for path in given.rglob("*") if path.is_file()):
        name = file.relative_to(given).as_posix()
        if file.suffix == ".py":
            py_compile.compile(str(file), "/one.pyc", dfile=name, doraise=True, optimize=1)
            name, content = name + "c", pathlib.Path("/one.pyc").read_bytes()
        else:
            content = file.read_bytes()
        archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
`);
fs.writeFileSync(archive, python.FS.readFile("/tool.zip"));

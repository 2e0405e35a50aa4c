"""OpenSim's ScaleTool: a script, since OpenSim stands in another environment.

It reads JSON from stdin: `setup`, the file of a ScaleTool, or none; `printed`, files of models to write anew as
OpenSim reads them, by the files to write. It prints the number of failures.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import opensim as osim

if __name__ == "__main__":
    wanted = json.load(sys.stdin)
    osim.Logger.setLevelString("off")
    failures = 0
    if "setup" in wanted:
        os.chdir(Path(wanted["setup"]).parent)
        osim.ScaleTool(wanted["setup"]).run()  # its answer is false, too, where it places no markers
    for source, target in wanted.get("printed", {}).items():
        model = osim.Model(source)
        model.initSystem()
        failures += not model.printToXML(target)
    print("\n" + json.dumps(failures))

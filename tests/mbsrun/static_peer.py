"""OpenSim's tools of inverse dynamics and static optimisation: a script, since OpenSim stands in another environment.

It reads JSON from stdin: `model`, `motion` and `loads`, paths of files, `body` on which the loads act, and `reserve`,
the optimal force of a reserve actuator on each coordinate. It prints JSON: `forces` by coordinate, and `activations` by
muscle and reserve.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import opensim as osim


def read(path: Path) -> dict[str, list[float]]:
    table = osim.TimeSeriesTable(str(path))
    found = {name: [float(x) for x in table.getDependentColumn(name).to_numpy()] for name in table.getColumnLabels()}
    return {"time": [float(x) for x in table.getIndependentColumn()], **found}


def write_loads(given: dict[str, Any], folder: Path) -> str:
    loads = osim.ExternalLoads()
    loads.setDataFileName(given["loads"])
    force = osim.ExternalForce()
    force.setName("plate")
    force.set_applied_to_body(given["body"])
    force.set_force_identifier("ground_force_v")
    force.set_point_identifier("ground_force_p")
    force.set_torque_identifier("ground_torque_")
    force.set_force_expressed_in_body("ground")
    force.set_point_expressed_in_body("ground")
    loads.cloneAndAppend(force)
    path = str(folder / "loads.xml")
    loads.printToXML(path)
    return path


def find_forces(given: dict[str, Any], folder: Path, loads: str) -> dict[str, list[float]]:
    model = osim.Model(given["model"])
    tool = osim.InverseDynamicsTool()
    tool.setModel(model)
    tool.setCoordinatesFileName(given["motion"])
    tool.setExternalLoadsFileName(loads)
    tool.setLowpassCutoffFrequency(-1)
    tool.setResultsDir(str(folder))
    tool.setOutputGenForceFileName("forces.sto")
    excluded = osim.ArrayStr()
    excluded.append("Muscles")
    tool.setExcludedForces(excluded)
    times = read(Path(given["motion"]))["time"]
    tool.setStartTime(times[0])
    tool.setEndTime(times[-1])
    tool.run()
    return read(folder / "forces.sto")


def find_activations(given: dict[str, Any], folder: Path, loads: str) -> dict[str, list[float]]:
    model = osim.Model(given["model"])
    for k in range(model.getCoordinateSet().getSize()):
        name = model.getCoordinateSet().get(k).getName()
        reserve = osim.CoordinateActuator(name)
        reserve.setName(f"reserve_{name}")
        reserve.setOptimalForce(given["reserve"])
        model.addForce(reserve)
    model.finalizeConnections()
    model.printToXML(str(folder / "model.osim"))
    times = read(Path(given["motion"]))["time"]
    shares = osim.StaticOptimization()
    shares.setActivationExponent(2)
    shares.setConvergenceCriterion(1e-12)
    shares.setMaxIterations(1000)
    shares.setStartTime(times[0])
    shares.setEndTime(times[-1])
    tool = osim.AnalyzeTool()
    tool.setName("so")
    tool.setModelFilename(str(folder / "model.osim"))
    tool.setReplaceForceSet(False)
    tool.getAnalysisSet().cloneAndAppend(shares)
    tool.setCoordinatesFileName(given["motion"])
    tool.setExternalLoadsFileName(loads)
    tool.setLowpassCutoffFrequency(-1)
    tool.setStartTime(times[0])
    tool.setFinalTime(times[-1])
    tool.setResultsDir(str(folder))
    tool.printToXML(str(folder / "so.xml"))
    osim.AnalyzeTool(str(folder / "so.xml")).run()  # a tool that is not read from a file wants states
    return read(folder / "so_StaticOptimization_activation.sto")


if __name__ == "__main__":
    osim.Logger.setLevelString("Off")
    wanted = json.load(sys.stdin)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        file = write_loads(wanted, place)
        results = {"forces": find_forces(wanted, place, file), "activations": find_activations(wanted, place, file)}
        print("\n" + json.dumps(results))

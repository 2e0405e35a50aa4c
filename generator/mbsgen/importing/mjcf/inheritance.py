"""MJCF: included files and default classes, resolved to plain elements and attributes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mbsgen.documents import abbreviate, nearest
from mbsgen.errors import InputError
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element, read_markup

MAIN = "main"
MAX_FILES = 50
MAX_INCLUSION = 10  # files in files
_ACTUATORS = frozenset(  # a class has one default for all of them
    (
        "general", "motor", "position", "velocity", "intvelocity", "orientation", "pid", "damper", "cylinder", "muscle",
        "adhesion", "dcmotor", "plugin",
    )
)  # fmt: skip
_ACTUATOR = "actuator"
SERVO = frozenset(  # attributes by which an actuator has a gain, a bias or a state
    (
        "gainprm", "gaintype", "biasprm", "biastype", "dynprm", "dyntype", "actdim", "kp", "kv", "dampratio",
        "timeconst", "area", "diameter", "bias",
    )
)  # fmt: skip
_ROWS = ("size", "stiffness", "damping", "gear")  # of which a file may give the first numbers, and inherit the others


def include_files(root: Element, bounds: Path | None, findings: Findings) -> Element:
    """Replace inclusions by the content of the files, each of which may be included once.

    Paths begin at the folder of the first file; where there is no such file, at the folder of the file that includes
    it. All are in the folder `bounds` or below it, by default the folder of the first one.
    """
    file = Path(root.file).resolve()
    bounds = file.parent if bounds is None else bounds.resolve()
    return _Inclusion(file.parent, bounds, findings).expand(root, (file,))


def find_file(folders: Sequence[Path], name: str) -> Path:
    """Return the path of a file in the first folder that has it, else in the first one; / where it cannot be one."""
    try:
        paths = [(folder / name).resolve() for folder in folders]
        return next((path for path in paths if path.is_file()), paths[0])
    except (OSError, ValueError, RuntimeError):
        return Path("/")


class _Inclusion:
    """Reads included files."""

    def __init__(self, folder: Path, bounds: Path, findings: Findings) -> None:
        self._folder = folder
        self._bounds = bounds
        self._findings = findings
        self._seen = set[Path]()

    def expand(self, element: Element, files: tuple[Path, ...]) -> Element:
        """Expand the elements below an element of the last of `files`, each of which included the next."""
        children: list[Element] = []
        for child in element.children:
            if child.tag == "include":
                children += self._include(child, files)
            elif any(below.tag == "include" for below in child.walk()):
                children.append(self.expand(child, files))
            else:
                children.append(child)
        return replace(element, children=tuple(children))

    def _include(self, element: Element, files: tuple[Path, ...]) -> tuple[Element, ...]:
        name = element.attributes.get("file", "")
        if len(self._seen) >= MAX_FILES or len(files) > MAX_INCLUSION:
            self._findings.fault(element, "very many files include each other", "put them into one")
            return ()
        if element.children:
            self._findings.fault(element, "an include with elements in it", "move them out of it")
        path = find_file((self._folder, files[-1].parent), name)
        if not name or not path.is_relative_to(self._bounds):
            remedy = (
                "include files from the model's folder, by a relative path, or name a folder that holds all: --root"
            )
            self._findings.fault(element, f"{abbreviate(name)} is not in the folder of the model", remedy)
            return ()
        if path in files:
            self._findings.fault(element, f"{abbreviate(name)} includes itself", "take the inclusion away")
            return ()
        if path in self._seen:
            remedy = "include each file once: MuJoCo takes none twice"
            self._findings.fault(element, f"{abbreviate(name)} is already included", remedy)
            return ()
        self._seen.add(path)
        try:
            included = read_markup(path)
        except InputError as error:
            self._findings.faults += error.faults
            self._findings.fault(element, f"{abbreviate(name)} cannot be included", "mend that file")
            return ()
        return self.expand(included, (*files, path)).children


class Defaults:
    """The default classes of a file: attributes by class and tag."""

    def __init__(self, root: Element, findings: Findings) -> None:
        self._findings = findings
        self._classes: dict[str, dict[str, dict[str, str]]] = {MAIN: {}}
        for section in root.all("default"):
            self._read(section, MAIN, top=True)

    def _read(self, section: Element, outer: str, *, top: bool = False) -> None:
        name = section.attributes.get("class", MAIN if top else "")
        if not name:
            self._findings.fault(section, "a default without a class", "name its class")
            return
        if not top and name in self._classes:
            self._findings.fault(section, f"a second default class {abbreviate(name)}", "give each its own name")
        if top:
            name = MAIN  # whatever its class is called
            if "class" in section.attributes:
                self._classes.setdefault(section.attributes["class"], self._classes[MAIN])
        settings = self._classes.setdefault(name, {tag: dict(own) for tag, own in self._classes[outer].items()})
        seen = set[str]()
        for element in section.children:
            if element.tag != "default":
                kind = _find_kind(element.tag)
                if element.tag in seen:
                    self._findings.fault(element, f"a second {element.tag[:40]} of a default", "write one")
                seen.add(element.tag)
                settings[kind] = _override(settings.get(kind, {}), element.attributes)
                if kind == _ACTUATOR and element.tag != "general":  # it sets them anew
                    kept = {key: text for key, text in settings[kind].items() if key not in SERVO}
                    settings[kind] = kept if element.tag == "motor" else {**kept, "gaintype": element.tag}
        for inner in section.all("default"):
            self._read(inner, name)

    def resolve(self, element: Element, active: str, tag: str = "") -> Mapping[str, str]:
        """Return the attributes of an element with the defaults of its class, or of the active class.

        `tag` is what the defaults call it, if not the element's own.
        """
        name = element.attributes.get("class", active)
        if name not in self._classes:
            self.check(element, name)
            name = MAIN
        return _override(self._classes[name].get(_find_kind(tag or element.tag), {}), element.attributes)

    def check(self, element: Element, name: str) -> str:
        """Return an existing class; a fault where there is none of the name."""
        if name in self._classes:
            return name
        meant = nearest(name, list(self._classes))
        remedy = f"did you mean {abbreviate(meant)}?" if meant else "define it under <default>"
        self._findings.fault(element, f"there is no default class {abbreviate(name)}", remedy)
        return MAIN


def _override(inherited: Mapping[str, str], own: Mapping[str, str]) -> dict[str, str]:
    """Return inherited attributes with an element's own; a shorter row keeps the end of the inherited one."""
    found = {**inherited, **own}
    for key in _ROWS:
        if key in inherited and key in own:
            words = own[key].split()
            found[key] = " ".join([*words, *inherited[key].split()[len(words) :]])
    return found


def _find_kind(tag: str) -> str:
    """Return the name under which defaults are kept."""
    return _ACTUATOR if tag in _ACTUATORS else tag

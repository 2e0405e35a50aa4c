"""Files of other formats -> Model: URDF, and MJCF of MuJoCo. Nothing but the file, and what it includes, is read."""

from __future__ import annotations

from mbsgen.importing.drafting import Choices, Imported, Mimic
from mbsgen.importing.findings import Notice
from mbsgen.importing.reading import import_model, is_foreign
from mbsgen.importing.writing import write_imported

__all__ = ["Choices", "Imported", "Mimic", "Notice", "import_model", "is_foreign", "write_imported"]

"""Files of other formats (see `formats`) -> Model. Nothing but the file, and the files that it includes, is read."""

from __future__ import annotations

from mbsgen.importing.choices import Choices, Imported, Mimic
from mbsgen.importing.findings import Notice
from mbsgen.importing.formats import import_model, is_foreign, list_formats
from mbsgen.importing.writing import write_imported

__all__ = ["Choices", "Imported", "Mimic", "Notice", "import_model", "is_foreign", "list_formats", "write_imported"]

"""The forms that the runtime uses are in the generator's catalogue."""

from __future__ import annotations

from mbsgen.formulations import catalogue, ports
from mbsgen.tape.ports import Port
from mbsrun import forms


def test_the_forms_of_the_runtime_are_those_of_the_catalogue() -> None:
    def list_giving(result: Port) -> tuple[str, ...]:
        return tuple(name for name, entry in catalogue.FUNCTIONS.items() if result in entry.results)

    assert list_giving(ports.RESIDUAL) == forms.RESIDUALS
    assert list_giving(ports.ACCELERATIONS) == forms.ACCELERATIONS
    assert tuple(form.name for form in forms.FORMS) == tuple(catalogue.list_rows())
    assert set(forms.DIFFERENTIATED) == {name for name, entry in catalogue.FUNCTIONS.items() if entry.is_form}
    assert set(forms.FUNCTIONS) == {*forms.DIFFERENTIATED, *list_giving(ports.MASS_MATRIX)}

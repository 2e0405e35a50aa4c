"""The forms that the runtime uses are in the generator's catalogue."""

from __future__ import annotations

from mbsgen.formulations import catalogue
from mbsgen.roles import Role
from mbsrun import forms


def test_the_forms_of_the_runtime_are_those_of_the_catalogue() -> None:
    assert catalogue.list_giving(Role.RESIDUAL) == forms.RESIDUALS
    assert catalogue.list_giving(Role.ACCELERATION) == forms.ACCELERATIONS
    assert tuple(form.name for form in forms.FORMS) == tuple(catalogue.list_rows())
    assert set(forms.DIFFERENTIATED) == {name for name, entry in catalogue.FUNCTIONS.items() if entry.is_form}
    assert set(forms.FUNCTIONS) == {*forms.DIFFERENTIATED, *catalogue.list_giving(Role.MASS_MATRIX)}

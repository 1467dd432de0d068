"""The columns between guidance and NMPC."""

import numpy as np
import pytest

from companion.core.guidance import reference_row


def test_names_and_indices_agree():
    for name, column in zip(reference_row.COLUMNS, reference_row.Column, strict=True):
        assert name.startswith(column.name.lower())


@pytest.mark.parametrize("turns", [-2, 0, 3])
def test_headings_are_brought_near(turns):
    psi_ref = np.array([3.1, -3.1, -3.0])
    got = reference_row.near(psi_ref, 3.0 + turns * 2 * np.pi)
    assert np.allclose(got - turns * 2 * np.pi, [3.1, 2 * np.pi - 3.1, 2 * np.pi - 3.0])

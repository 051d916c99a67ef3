"""Fits to evidence: scatter that there is not is not made up."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.diagnose.evidence import fit
from gyrocal_ros.ekf.evidence import Evidence


def test_what_shows_in_one_block_alone_is_as_sure_as_the_filter_says() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        columns = rng.normal(size=(5, 40, 2))
        columns[np.arange(5) != 2, :, 0] = 0.0
        seen = columns @ [3.0, -1.0] + rng.normal(size=(5, 40))
        information = np.einsum('bni,bnj->bij', columns, columns)
        evidence = Evidence((), 10.0 * np.arange(5), information, np.einsum('bni,bn->bi', columns, seen))
        fitted = fit(evidence, np.arange(2))
        assert fitted is not None and np.isfinite(fitted.sigma)
        np.testing.assert_allclose(fitted.values, [3.0, -1.0], atol=0.6)
        np.testing.assert_allclose(fitted.covariance, np.linalg.inv(information.sum(axis=0)), rtol=1e-6)

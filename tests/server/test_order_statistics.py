import numpy as np
import pytest

from revnm_server.order_statistics import median, quantiles


@pytest.mark.parametrize("count", [1, 2, 3, 10, 999, 1000])
def test_they_are_those_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    shares = (0.0, 0.01, 0.2, 0.5, 0.98, 1.0)
    assert median(values) == np.median(values)
    np.testing.assert_allclose(quantiles(values, shares), np.quantile(values, shares), rtol=0.0, atol=1e-12)


def test_the_numbers_are_left_in_their_order() -> None:
    values = np.array([3.0, 1.0, 2.0])
    median(values)
    quantiles(values, (0.5,))
    assert values.tolist() == [3.0, 1.0, 2.0]

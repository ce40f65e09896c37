"""Products of effects, each reduced once for all tests that read them."""

import pytest
from products import product


@pytest.fixture(scope="session")
def rom_of(tmp_path_factory):
    """The ROM of a kind, see `products.kinds`."""
    made = {}

    def rom(kind):
        if kind not in made:
            made[kind] = product(tmp_path_factory.mktemp("product"), *kind)
        return made[kind]

    return rom

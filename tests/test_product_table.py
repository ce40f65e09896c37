"""The table of products on the package's page is what the code does: each row is run again."""

import re

import pytest
from product_table import HEADING, PAGE, line, products, row

SECTION = PAGE.read_text().partition(HEADING)[2].partition("\n## ")[0]


@pytest.mark.slow
@pytest.mark.parametrize(("law", "frame"), list(products()))
def test_row_is_what_the_code_does(law, frame):
    notes = re.findall(r"^\d+\. (.*)$", SECTION, flags=re.M)
    numbered = list(notes)
    made = line(law, frame, row(law, frame), numbered)
    assert numbered == notes, "python tests/product_table.py"
    assert made in SECTION.splitlines(), "python tests/product_table.py"

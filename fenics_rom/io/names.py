"""Names of contact modes, outputs, ...: they become names inside HDF5 files."""

import re

NAME = re.compile(r"[\w-]{1,100}")
NAME_IN_WORDS = "letters, digits, _ and -, at most 100"

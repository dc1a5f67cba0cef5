"""What is said of files, one after the other.

    python tests/io/said_of_files.py FILE ...

prints, as JSON, what forks say of each. They are forks of a process without threads and with little in its memory, which
counts as theirs: a test run is neither.
"""

import json
import re
import sys

from retarget.errors import RetargetError
from retarget.io import load
from retarget.io.child_fork import forking


def said_of(path):
    """Notes, or the refusal; of a parser's failure that it failed, for its words depend on the memory that was left to it."""
    try:
        return list(load(path).notes)
    except RetargetError as error:
        return re.sub(r"(cannot be read as \w+) \(.*\)", r"\1", str(error), flags=re.DOTALL)


if __name__ == "__main__":
    with forking():
        print(json.dumps([said_of(path) for path in sys.argv[1:]]))

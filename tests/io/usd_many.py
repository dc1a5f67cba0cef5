"""Reads many USD files as the reader's process does, one after the other: python usd_many.py FOLDER FIRST END SUFFIX.

Prints a line a file, so that its caller knows which one took the process down.
"""

import signal
import sys

from retarget.io.child import limit
from retarget.io.usd_child import work


class TooLong(Exception):
    pass


def stop(*_):
    raise TooLong


def main(folder, first, end, suffix):
    limit()
    signal.signal(signal.SIGALRM, stop)
    for number in range(int(first), int(end)):
        signal.alarm(20)
        try:
            work(f"{folder}/{number}.{suffix}", f"{folder}/{number}.glb")
            said = "read"
        except TooLong:
            said = "hangs"
        except Exception:
            said = "refused"
        signal.alarm(0)
        print(said, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

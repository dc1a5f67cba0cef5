"""Kill a batch at random moments, start it again until it is done, and count what was lost.

    python tests/batch_kills.py --kills 20 --seed 0

Prints `batch_lost`: results that are missing or differ from those of a run without kills, finished ones that were done
again, and files left behind. In turn the whole process group is killed, and the master process alone.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE / "batch"), str(HERE.parent / "src")]

QUICK = ["--method", "copy-rotations", "--jobs", "2"]


def start(folder: Path, output: Path, options=QUICK) -> subprocess.Popen:
    words = ["-m", "retarget", "batch", folder / "m", folder / "c", "-o", output, *options]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        [sys.executable, *map(str, words)], stdout=subprocess.DEVNULL, start_new_session=True, env=environment
    )


def kill_and_resume(folder: Path, kills: int, seed: int, tell=lambda text: None, options=QUICK) -> dict[str, int]:
    """Batches over `folder`'s m and c, killed `kills` times in all; how many times what was lost."""
    from made_folders import contents, records

    rng = random.Random(seed)
    started = time.monotonic()
    assert start(folder, folder / "whole", options).wait(timeout=600) == 0
    duration = time.monotonic() - started
    whole = contents(folder / "whole")
    report = {"kills": 0, "missing": 0, "different": 0, "done_again": 0, "left_behind": 0, "finished_when_killed": 0}
    batches = 0
    while report["kills"] < kills:
        output = folder / f"killed{batches}"
        batches += 1
        while True:
            batch = start(folder, output, options)
            if report["kills"] < kills:
                try:
                    batch.wait(timeout=rng.uniform(0.2, 1.1) * duration)
                except subprocess.TimeoutExpired:
                    group = report["kills"] % 2 == 0
                    (os.killpg if group else os.kill)(batch.pid, signal.SIGKILL)
                    report["kills"] += 1
                    report["finished_when_killed"] += (
                        len(records(output)) if (output / "manifest.jsonl").exists() else 0
                    )
                    tell(f"kill {report['kills']}: {'all processes' if group else 'the master alone'}")
                    if not group:
                        wait_for_orphans(output)
            if batch.wait(timeout=600) == 0:
                break
            assert batch.returncode == -signal.SIGKILL, batch.returncode
        found = contents(output)
        report["missing"] += len(whole.keys() - found.keys())
        report["left_behind"] += len(found.keys() - whole.keys())
        report["different"] += sum(found[name] != whole[name] for name in whole.keys() & found.keys())
        done = [json.dumps(record["done"]) for record in records(output)]
        report["done_again"] += len(done) - len(set(done))
        shutil.rmtree(output)
    report["batches"] = batches
    report["batch_lost"] = report["missing"] + report["different"] + report["done_again"] + report["left_behind"]
    return report


def wait_for_orphans(output: Path, seconds: float = 20.0) -> None:
    """The workers of a master that was killed end by themselves: they hold its lock as long as they live."""
    if not (output / ".batch.lock").exists():
        return
    with open(output / ".batch.lock") as file:
        until = time.monotonic() + seconds
        while True:
            try:
                return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                assert time.monotonic() < until, "workers outlive their master"
                time.sleep(0.02)


if __name__ == "__main__":
    from made_folders import make_characters, make_motions

    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--kills", type=int, default=20)
    asked.add_argument("--seed", type=int, default=0)
    asked = asked.parse_args()
    with tempfile.TemporaryDirectory() as place:
        make_motions(Path(place) / "m")
        make_characters(Path(place) / "c")
        print(json.dumps(kill_and_resume(Path(place), asked.kills, asked.seed, lambda text: print(text, flush=True))))

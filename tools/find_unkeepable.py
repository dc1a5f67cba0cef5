"""Search which contacts of the benchmark set no pose can keep, and store them (minutes; run from the repository's root).

Rerun when the embedded motions, the bodies of the set or the contact detection change.
"""

import sys
import time

import numpy as np

from retarget.contact.carried import carry_vertices
from retarget.evaluate import keepable
from retarget.evaluate.contact_cases import cases_of, performances
from retarget.evaluate.touch import observe
from retarget.retargeting import prepare

SEED = 1


def main() -> None:
    lost = {}
    for performance in performances(quick=False):
        touch = observe(performance.source, performance.motion)
        for case in cases_of(performance, quick=False):
            started = time.perf_counter()
            copied = prepare(performance.source, case.target, "copy-rotations", limits=False).retargeter(performance.motion)
            performer = performance.source
            carried = carry_vertices(performer.character, performer.humanoid, case.target.character, case.target.humanoid)
            threshold = touch.detector.threshold * case.target.height / performer.height
            kept = keepable.search(touch, case.target, carried, copied.motion, threshold, SEED)
            tracks = touch.contacts.tracks
            rows = np.unique(np.stack([tracks.vertex[~kept], tracks.part[~kept]], axis=1), axis=0)
            lost[f"{performance.name}/{case.target_name}"] = rows
            seconds = time.perf_counter() - started
            print(f"{performance.name} -> {case.target_name}: {(~kept).sum()} of {len(kept)} lost, {seconds:.1f} s")
            sys.stdout.flush()
    keepable.store(lost)


if __name__ == "__main__":
    main()

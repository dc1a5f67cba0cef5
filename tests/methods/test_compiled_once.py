"""Loops that `make setup` compiles are those that a first clip calls: none is compiled anew while a user waits."""

import subprocess
import sys
from pathlib import Path

CODE = """
import sys
sys.path.insert(0, {tests!r})
from made_motions import actor
from retarget.contact import part_field_kernels
from retarget.methods.interaction import part_equation_kernels
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.retargeting import prepare
loops = part_field_kernels.part_figures, part_equation_kernels.hand_equations, part_equation_kernels.solve_parts
for kernels in (part_field_kernels, part_equation_kernels):
    kernels.compile_kernels()
prepare(actor(), actor("heavy"), "learned-interaction").retargeter(cut(embedded_motion("wave"), 0.5, 0.8))
print([len(loop.signatures) for loop in loops])
"""


def test_the_network_s_loops_are_compiled_once():
    tests = str(Path(__file__).parents[1])
    done = subprocess.run([sys.executable, "-c", CODE.format(tests=tests)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[1, 1, 1]"

# A fresh machine needs Python 3.10 or later and make; everything else comes from here.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo test bench setup clean

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml requirements-test.txt
	@echo "setting up $(VENV) (once)"
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/pip install --quiet --disable-pip-version-check -r requirements-test.txt --editable '.[test]'
	@echo "compiling the collision kernels (once, about ten seconds)"
	@$(BIN)/python -c "from retarget.contact import collide, pair_kernels, part_field_kernels, skin_kernels; from retarget.geometry import capture_kernels, closest_kernels, turn_kernels; from retarget.methods.interaction import part_equation_kernels; from retarget.methods.scan import cloud_kernels, fit_kernels; from retarget.motion import limit_kernels; from retarget.rig import fit_kernels as body_kernels; [each.compile_kernels() for each in (collide, pair_kernels, part_field_kernels, skin_kernels, capture_kernels, closest_kernels, turn_kernels, part_equation_kernels, cloud_kernels, fit_kernels, limit_kernels, body_kernels)]"
	@# The Khronos validator checks written files where Node is at hand; without it those tests are skipped.
	@if command -v npm >/dev/null 2>&1; then npm install --no-save --silent --no-audit --no-fund gltf-validator@2.0.0-dev.3.10 || true; fi
	@touch $@

demo: setup
	@$(BIN)/python examples/demo.py out/demo

test: setup
	@$(BIN)/python -m pytest -n 2 --dist worksteal
	@$(MAKE) --no-print-directory --jobs 2 gate-rig-transfer gate-contact gate-interaction

# A quick bench against the committed baseline. Each takes one core; the longest is named first above.
gate-%: setup
	@$(BIN)/retarget bench $* --quick --gate

bench: setup
	@$(BIN)/retarget bench skeletal
	@$(BIN)/retarget bench contact
	@$(BIN)/retarget bench interaction
	@$(BIN)/retarget bench rig-transfer
	@$(BIN)/retarget bench scan
	@$(BIN)/retarget bench shape-transfer

clean:
	rm -rf $(VENV) out build *.egg-info src/*.egg-info

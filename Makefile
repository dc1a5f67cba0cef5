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
	@touch $@

demo: setup
	@$(BIN)/python examples/demo.py out/demo

test: setup
	@$(BIN)/python -m pytest -n 2

bench: setup
	@$(BIN)/retarget bench skeletal

clean:
	rm -rf $(VENV) out build *.egg-info src/*.egg-info

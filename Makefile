PYTHON ?= python3
VENV ?= .venv
RUN := $(VENV)/bin/python
PIP := $(RUN) -m pip --disable-pip-version-check --quiet

.PHONY: train setup test lint notebooks lock clean

train: $(VENV)/.ready  ## train with the defaults
	$(RUN) train.py

setup: $(VENV)/.ready  ## make the environment alone

test: $(VENV)/.ready-dev  ## run the tests
	$(RUN) -m pytest -n 2 --dist loadfile

lint: $(VENV)/.ready-dev  ## formatter, linter, type checker
	$(RUN) -m ruff format --check .
	$(RUN) -m ruff check .
	$(RUN) -m mypy

notebooks: $(VENV)/.ready-dev  ## run the notebooks and keep what they show
	$(RUN) notebooks/execute.py

# The environment: exact versions from a lock, brought up to date when the lock changes.
$(VENV)/.ready: requirements.lock pyproject.toml
	@echo "setting up $(VENV) (a minute or two, once)"
	test -x $(RUN) || $(PYTHON) -m venv $(VENV)
	$(PIP) install -r requirements.lock
	$(PIP) install --no-deps -e .
	$(RUN) -m pip check
	touch $@

$(VENV)/.ready-dev: requirements-dev.lock $(VENV)/.ready
	$(PIP) install -r requirements-dev.lock
	$(RUN) -m pip check
	touch $@

lock:  ## choose versions anew (needs uv)
	uv pip compile --universal --python-version 3.11 --no-emit-index-url --no-header \
		--no-annotate --extra view pyproject.toml -o requirements.lock
	uv pip compile --universal --python-version 3.11 --no-emit-index-url --no-header \
		--no-annotate --extra dev -c requirements.lock pyproject.toml -o requirements-dev.lock

clean:
	rm -rf $(VENV)

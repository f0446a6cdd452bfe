# `make demo` and `make test` work in a fresh clone with python3, python3-venv, make and a network;
# neither needs a C compiler.

PYTHON ?= python3
PYTEST_ARGS ?=
BENCH_ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -q
BUILD_INPUTS := pyproject.toml hatch_build.py vhp_cli/kernels/build.py $(wildcard vhp_cli/kernels/*.[ch])
DEMO := build/demo
SANITIZED := $(CURDIR)/build/sanitize/kernels.so
SANITIZE_TESTS ?= tests/kernels

.DEFAULT_GOAL := help
.PHONY: help demo test test-fast kernels lint types sanitize coverage bench docs wheel system-libraries clean

help: ## show this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/\1\t\2/p' $(MAKEFILE_LIST) | expand -t 18

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.package: $(BIN)/python $(BUILD_INPUTS)
	$(PIP) install -e .
	@touch $@

$(VENV)/.test: $(BIN)/python $(BUILD_INPUTS)
	$(PIP) install -e '.[test]'
	@touch $(VENV)/.package $@

$(VENV)/.dev: $(VENV)/.test
	$(PIP) install -e '.[test,dev]'
	@touch $@

demo: $(VENV)/.package system-libraries ## make two small models, one sound and one with defects, check both, heal and export the second, let the first breathe
	@rm -rf $(DEMO)
	$(BIN)/vhp phantom $(DEMO)/phantom
	$(BIN)/vhp check $(DEMO)/phantom --report $(DEMO)/phantom.json --report-html $(DEMO)/phantom.html
	$(BIN)/vhp phantom $(DEMO)/broken --defects 7 --defect-rules T,X,Q,F003,F004
	@echo '$(BIN)/vhp check $(DEMO)/broken --report $(DEMO)/broken.json --report $(DEMO)/broken.md'
	@$(BIN)/vhp check $(DEMO)/broken --report $(DEMO)/broken.json --report $(DEMO)/broken.md; code=$$?; \
	  test $$code -eq 1 || { echo "demo: the broken model must end with exit code 1, not $$code" >&2; exit 1; }
	@echo 'The sound model passed; the broken one was refused with exit code 1, as it must be.'
	$(BIN)/vhp heal $(DEMO)/broken -o $(DEMO)/healed --report $(DEMO)/healed.md
	$(BIN)/vhp check $(DEMO)/healed
	@echo 'Healed, the broken model passes.'
	$(BIN)/vhp export $(DEMO)/healed -o $(DEMO)/hfss --for hfss --frequency 300MHz
	$(BIN)/vhp breathe $(DEMO)/phantom -o $(DEMO)/breathing
	@echo 'Pages for a browser: $(DEMO)/phantom.html $(DEMO)/breathing/animation.html'
	@echo 'Reports: $(DEMO)/phantom.json $(DEMO)/broken.json $(DEMO)/broken.md $(DEMO)/healed/report.json $(DEMO)/healed.md $(DEMO)/breathing/report.json'
	@echo 'Defects planted: $(DEMO)/broken/planted.json'

test: $(VENV)/.test system-libraries ## run every test
	$(BIN)/python -m pytest --slow -n auto --dist worksteal $(PYTEST_ARGS)

test-fast: $(VENV)/.test system-libraries ## run the tests but for the slow ones
	$(BIN)/python -m pytest -n auto --dist worksteal $(PYTEST_ARGS)

kernels: ## compile the C kernels in place (needs a C compiler, or ziglang)
	$(PYTHON) vhp_cli/kernels/build.py

lint: $(VENV)/.dev ## style of the Python code
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev ## types of the package
	$(BIN)/mypy

# The interpreter isn't instrumented: the runtime is loaded ahead of it, and its own leaks are left alone.
# A finding ends the process, so what it says must not wait in pytest's capture.
sanitize: $(VENV)/.test ## the kernel tests under the address and undefined-behaviour sanitizers (gcc)
	CC=gcc $(BIN)/python vhp_cli/kernels/build.py --check --sanitize --output $(SANITIZED)
	LD_PRELOAD="$$(gcc -print-file-name=libasan.so)" ASAN_OPTIONS=detect_leaks=0 \
	  UBSAN_OPTIONS=print_stacktrace=1 PYTHONMALLOC=malloc VHP_KERNELS=$(SANITIZED) \
	  $(BIN)/python -m pytest -p no:cacheprovider --capture=sys $(SANITIZE_TESTS) $(PYTEST_ARGS)

coverage: $(VENV)/.dev ## line and branch coverage of the tests
	$(BIN)/coverage run --branch --source=vhp_cli -m pytest --slow $(PYTEST_ARGS)
	$(BIN)/coverage report --show-missing --skip-covered

bench: $(VENV)/.package ## time vhp check beside other libraries; BENCH_ARGS='--rounds 3'
	$(PIP) install -e '.[bench]'
	$(BIN)/python benchmarks/check.py $(BENCH_ARGS)

docs: $(VENV)/.package ## the pages of docs/ that come from the code: rules and commands
	$(BIN)/python tools/make_docs.py

wheel: $(BIN)/python ## source archive and wheel in dist/
	$(PIP) install build
	$(BIN)/python -m build

system-libraries: $(BIN)/python ## libraries that pymeshlab needs: look for them, install them as root on Debian
	@tools/system_libraries.sh $(BIN)/python

clean: ## remove everything that was built
	rm -rf $(VENV) build dist vhp_cli/kernels/_kernels.* vhp_cli/kernels/.build-*
	rm -rf .pytest_cache .ruff_cache .mypy_cache .hypothesis .coverage
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Development tasks; `make` lists them.

PYTHON ?= python3
# Requirement for torch if none is installed; tools/install.py has the default.
TORCH ?=
export TORCH

PACKAGES := fluidsnet datamodules callbacks tools
# mypy and ruff fail if they cannot write a cache, as in a read-only checkout.
MYPY_CACHE := $(if $(shell test -w . && echo yes),.mypy_cache,/dev/null)
IN_VENV := .venv/bin/python

.DEFAULT_GOAL := help
.PHONY: help setup demo lint test docs soak clean

help: ## list these tasks
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-6s  %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo
	@echo 'make setup PYTHON=python3.12                  makes .venv with another Python'
	@echo 'make setup TORCH="torch==2.9.1 --index-url …" installs that torch in .venv'

setup: ## install FluidsNet and its dependencies into .venv; about six minutes on two cores
	@$(PYTHON) -m tools.install

demo: setup ## simulate, train, test and roll out a small dam break; about five minutes
	$(IN_VENV) -m tools.demo

lint: setup ## check style and types
	$(IN_VENV) -m ruff check --no-cache $(PACKAGES) tests
	$(IN_VENV) -m ruff format --no-cache --check $(PACKAGES) tests
	$(IN_VENV) -m mypy --cache-dir=$(MYPY_CACHE) $(PACKAGES)

test: setup lint ## check style and types, then run every test
	@# GOMP_SPINCOUNT as in fluidsnet/main.py. Tests of a file share fixtures: one worker runs a file.
	GOMP_SPINCOUNT=1000 $(IN_VENV) -m pytest -n 2 --dist loadfile --no-loadscope-reorder

docs: setup ## build the documentation site in site/; every warning is an error
	NO_MKDOCS_2_WARNING=1 $(IN_VENV) -m mkdocs build --strict
	@echo 'Open site/index.html; to search, serve it: $(IN_VENV) -m http.server --directory site'

soak: setup ## try damaged data files for ten minutes; fails where one does harm
	$(IN_VENV) -m tools.soak

clean: ## remove .venv and caches; keeps the compiled wheels in the user's cache
	rm -rf .venv build dist site *.egg-info .mypy_cache .ruff_cache .pytest_cache
	find $(PACKAGES) tests -name __pycache__ -type d -prune -exec rm -rf {} +

# Everything a newcomer types. The first call of any target sets up .venv; nothing outside of this folder is touched.

PYTHON ?= $(shell for python in python3.11 python3.10 python3; do \
	$$python -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] < (3, 12))' 2>/dev/null && echo $$python && break; done)
BIN := .venv/bin

.PHONY: demo test test-fast lint bench resources proto clean

demo: .venv/ready  ## the thesis' table-setting plan; leaves set_the_table.mcap
	$(BIN)/pycram demo --log set_the_table.mcap

test: .venv/ready-dev  ## all tests
	$(BIN)/pytest -n auto --ignore=tests/benchmarks
	$(BIN)/pytest tests/benchmarks -m "not long"

test-fast: .venv/ready-dev  ## the inner loop, under a minute
	$(BIN)/pytest -n auto -m "not slow" --ignore=tests/benchmarks

lint: .venv/ready-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: .venv/ready-dev  ## measures, and prints the tables
	$(BIN)/pytest tests/benchmarks -s

resources: .venv/ready-dev  ## makes kitchen, floor and objects anew
	$(BIN)/python resources/make_resources.py

proto: .venv/ready-dev  ## compiles recorder/proto/log.proto
	$(BIN)/python -m recorder.compile_proto

clean:
	rm -rf .venv dist build

.venv/bin/python:
	@test -n "$(PYTHON)" || { echo "PyCRAM needs Python 3.10 or 3.11 (PyBullet ships wheels for these); found none. Set PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv .venv

.venv/ready: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --editable .
	@touch $@

.venv/ready-dev: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --editable '.[dev]'
	@touch .venv/ready $@

# Everything a newcomer types. The first call of any target sets up .venv; nothing outside of this folder is touched,
# but by system-packages.
#
# PYTHON names the Python to take; else .ci/environment chooses 3.11, 3.12 or 3.13, in this order.

BIN := .venv/bin

# Tests start many processes. Where bytecode isn't kept, as containers often have it, each of them compiles all of it anew.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo extension test test-fast test-long test-lowest test-reading test-lerobot lint size systems pictures bench faults resources proto reference docs docs-serve system-packages clean

demo: .venv/ready  ## the thesis' table-setting plan; leaves set_the_table.mcap, the next time set_the_table.2.mcap
	$(BIN)/pycram demo --log set_the_table.mcap

test: .venv/ready-dev  ## the tests, and a slice of each long measure: some 4 minutes on two cores; with CI=true the costliest too
	$(BIN)/pytest -n 3 --dist worksteal -m "not long$(if $(CI),, and not costly)"

test-fast: .venv/ready-dev  ## the inner loop, under a minute
	$(BIN)/pytest -n auto --dist worksteal -m "not slow and not long and not costly"

test-long: .venv/ready-long  ## the full measures; a run that was ended goes on where it was
	$(BIN)/pytest -n auto --dist worksteal -m "long or measure or costly" --resume .measures/results.jsonl

test-lowest: .venv-lowest/ready  ## the inner loop with the lowest versions that pyproject.toml allows
	.venv-lowest/bin/pytest -n auto --dist worksteal -m "not slow and not long and not costly"

test-reading: .venv-reading/ready  ## reading recordings where neither engine nor viewer is installed
	.venv-reading/bin/pytest --noconftest -m "not slow" tests/replay/cli/test_reading_alone.py

test-lerobot: .venv/ready-long .venv-lerobot/ready  ## exported data sets with camera images, read by LeRobot itself (8 GB)
	$(BIN)/pytest tests/replay/runs/test_lerobot.py

lint: .venv/ready-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

size: .venv/ready-dev  ## lines, files and other figures of the source
	$(BIN)/python tests/source_size.py

extension:  ## packs the extension for VS Code as pycram-replay.vsix; needs Node.js
	cp LICENSE editors/vscode/LICENSE
	cd editors/vscode && npx --yes @vscode/vsce package --allow-missing-repository --out ../../pycram-replay.vsix
	rm editors/vscode/LICENSE

pictures: .venv/ready-dev  ## draws the film of the README and the pictures of the gallery anew
	$(BIN)/python docs/make_pictures.py

systems: .venv/ready-dev  ## writes the table of systems in docs/start/installing.md, from what the package index offers
	$(BIN)/pip install --quiet uv
	PATH=$(BIN):$$PATH $(BIN)/python .ci/systems

bench: .venv/ready-dev  ## measures, and prints the tables
	$(BIN)/pytest tests/benchmarks -s

faults: .venv/ready-dev  ## scores explanations on runs with known faults, in .measures/faults; continues where it was stopped
	$(BIN)/python -m tests.faults.benchmark .measures/faults

resources: .venv/ready-dev  ## makes kitchen, floor and objects anew
	$(BIN)/python resources/make_resources.py

PROTO_OUT := .
proto: .venv/ready-dev  ## compiles recorder/records/log.proto; its path is part of the descriptor's name, hence from here
	$(BIN)/python -m grpc_tools.protoc --proto_path=. --python_out=$(PROTO_OUT) --pyi_out=$(PROTO_OUT) recorder/records/log.proto

reference: .venv/ready-dev  ## writes pages of docs/reference and the typed constructors, from the code and the bundled models
	$(BIN)/python -m docs.make_reference docs/reference/designators.md
	$(BIN)/python -m docs.make_tables docs/reference
	$(BIN)/python -m docs.make_constructors pycram

docs: .venv/ready-dev  ## builds the site in site/, a folder for each version, as files for any web server
	$(BIN)/python -m docs.make_site site

docs-serve: .venv/ready-dev  ## serves the site at http://127.0.0.1:8000, and builds it again when a page changes
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs serve

system-packages:  ## what tests of windows, viewers and the browser need (Debian, Ubuntu)
	.ci/system-packages

clean:
	rm -rf .venv .venv-lowest .venv-reading .venv-lerobot dist build site

.venv/ready: pyproject.toml
	@.ci/environment .venv '.[all]'
	@touch $@

.venv/ready-dev: pyproject.toml
	@.ci/environment .venv '.[all,dev]'
	@touch .venv/ready $@

.venv/ready-long: pyproject.toml
	@.ci/environment .venv '.[all,dev,long]'
	@touch .venv/ready .venv/ready-dev $@

# uv resolves to the lowest versions, which pip can't; bytecode as pip makes it: warnings of compiling are no test's.
.venv-lowest/ready: pyproject.toml
	@.ci/environment .venv-lowest .
	.venv-lowest/bin/pip install --quiet uv
	.venv-lowest/bin/uv pip install --quiet --compile-bytecode --python .venv-lowest/bin/python --resolution lowest-direct --editable '.[all,dev]'
	@touch $@

.venv-reading/ready: pyproject.toml
	@.ci/environment .venv-reading .
	.venv-reading/bin/pip install --quiet 'pytest>=8.4'
	@touch $@

# Beside .venv, as LeRobot and PyCRAM need different releases of the viewer.
.venv-lerobot/ready: pyproject.toml
	@.ci/environment .venv-lerobot .
	.venv-lerobot/bin/pip install --quiet 'lerobot>=0.4,<0.5'
	@touch $@

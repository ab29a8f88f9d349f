# drivebus: `make demo` shows a virtual plant, `make test` runs every test. Both set up .venv first.
VENV := .venv
BIN := $(VENV)/bin
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' && echo $$p && break; done)
UV := $(shell command -v uv 2>/dev/null)
ifdef UV
INSTALL = VIRTUAL_ENV=$(VENV) uv pip install -q
else
INSTALL = $(BIN)/python -m pip install -q --disable-pip-version-check
endif
LOCKS := requirements/base.txt requirements/build.txt
# These measure this machine: one test at a time.
ALONE := tests/real
# These wait for a browser and for real clocks a third of the time: two browsers share the cores.
BROWSER := tests/web/page
# These hold to the real clock of slow buses and other programs: they wait nearly all the time, so four wait at once.
WAITING := tests/cli tests/interop tests/ports tests/gateways tests/service/process tests/system/test_demo_dashboard.py \
	tests/service/storage/test_settings.py tests/service/config/test_wizard.py tests/web/api/test_results.py
# The commands of the documentation wait for each other, so all requests of the API have the second core meanwhile.
DOCUMENTED := tests/test_examples.py tests/test_guides.py tests/test_api_guide.py tests/test_guide_commands.py \
	tests/web/api/test_schemathesis.py

# Python and pytest keep what they compile; otherwise each process of a test run compiles the same files again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test check docs bench coverage mutation verify structure fuzz lock clean python
help: ## List what can be made
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' Makefile | expand -t 14

demo: $(VENV)/.base ## A virtual plant of twelve drives in your browser; no hardware needed
	@$(BIN)/drivebus demo $(ARGS)

test: $(VENV)/.test ## Every test; missing peers are skipped by name (DRIVEBUS_REQUIRE_PEERS=1: fail)
ifdef ARGS
	$(BIN)/python -m pytest $(ARGS)
else
	$(BIN)/python -m pytest -n auto --dist loadfile tests $(foreach each,$(ALONE) $(BROWSER) $(WAITING) $(DOCUMENTED),--ignore $(each))
	$(BIN)/python -m pytest -n 2 --dist loadgroup $(DOCUMENTED)
	$(BIN)/python -m pytest -n 4 --dist loadfile $(WAITING)
	$(BIN)/python -m pytest -n 2 --dist worksteal $(BROWSER)
	$(BIN)/python -m pytest $(ALONE)
endif

check: $(VENV)/.test ## Formatting, lint, types, layers, texts and generated docs only
	$(BIN)/python -m pytest tests/test_quality_gates.py tests/test_architecture.py tests/test_words.py tests/test_i18n.py \
		tests/test_sentences.py tests/test_docs.py $(ARGS)

docs: $(VENV)/.test ## Write the generated pages again
	$(BIN)/python docs/generate.py

bench: $(VENV)/.test ## Benchmarks beside their peers; writes docs/reports/
	$(BIN)/python -m benchmarks $(ARGS)

coverage: $(VENV)/.test ## Branches of protocols, transaction, scheduler and permissives that their tests run; writes docs/reports/
	$(BIN)/python -m coverage run -m pytest -q -p no:cacheprovider tests/protocols tests/bus tests/families tests/profiles tests/drives/test_permissives.py
	PYTHONPATH=tests $(BIN)/python -m coverage_report $(ARGS)

mutation: $(VENV)/.test ## Change their lines one by one; the tests must notice (hours). ARGS=drives.permissives: one module
	PYTHONPATH=tests $(BIN)/python -m mutation $(ARGS)

verify: $(VENV)/.test ## Verification campaigns in virtual time, e.g. ARGS="stop --seed 1" or ARGS="all --slice"
	$(BIN)/python -m verification $(ARGS)

structure: $(VENV)/.test ## Measure the structure before and after; ARGS=--write writes docs/reports/structure.md
	$(BIN)/python -m verification.structure $(ARGS)

fuzz: $(VENV)/.test ## Fuzz every decoder (pip install atheris first; Linux)
	$(BIN)/python -m verification.atheris_fuzz $(ARGS)

python:
	@test -n "$(PYTHON)" || { echo "drivebus needs Python 3.11 or newer, and this machine has none on its path."; \
	echo "Install it: Debian/Ubuntu: sudo apt install python3 python3-venv · Fedora: sudo dnf install python3 · macOS: brew install python"; \
	echo "drivebus 需要 Python 3.11 或更高版本。安装：Debian/Ubuntu: sudo apt install python3 python3-venv"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "$(PYTHON) has no venv module."; \
	echo "Install it: sudo apt install $$($(PYTHON) -c 'import sys; print("python3.%d-venv" % sys.version_info[1])')"; \
	echo "$(PYTHON) 缺少 venv 模块，请用上面的命令安装。"; exit 1; }

$(VENV)/.base: $(LOCKS) pyproject.toml | python
	@echo "Setting up $(VENV) (once, about a minute) · 正在准备运行环境（仅一次）"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(INSTALL) --require-hashes -r requirements/base.txt -r requirements/build.txt
	@$(INSTALL) --no-build-isolation --no-deps -e .
	@touch $@

$(VENV)/.test: requirements/test.txt $(VENV)/.base
	@$(INSTALL) --require-hashes -r requirements/test.txt
	@touch $@

lock: ## Pin every dependency again: versions and hashes, no addresses
	sh requirements/lock.sh

clean: ## Remove the environment and caches
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .import_linter_cache

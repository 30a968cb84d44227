# `make demo` and `make test` need python3 (3.10 or newer, with venv) and the package index, nothing else.

PYTHON ?= python3
BIN = .venv/bin
READY = .venv/ready

.PHONY: demo test check docs figures gallery explorer inverse stability study bench clean

demo: $(READY)
	@$(BIN)/phong-bsdf demo -o out

test: $(READY)
	@$(BIN)/python -m pytest

check: $(READY)
	@$(BIN)/python -m pip install -q --group lint
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .
	@$(BIN)/pyright --pythonpath $(BIN)/python
	@$(BIN)/pyright --pythonpath $(BIN)/python --pythonversion 3.13

# Builds the pages and measures nothing; figures and tables are in the repository. The gallery shows scenes as they are now.
docs: $(READY)
	@$(BIN)/python docs/gallery.py --changed
	@$(BIN)/python -m sphinx -q -W --keep-going -b html docs out/docs
	@echo "The documentation is in $(CURDIR)/out/docs/index.html"

# Draws figures anew; ONLY="albedo.svg" draws that one.
figures: $(READY)
	@$(BIN)/python docs/figures.py $(ONLY)

# Renders all scenes small, for docs/gallery.md.
gallery: $(READY)
	@$(BIN)/python docs/gallery.py

# Writes the page of docs/explorer, and its picture where there is a Chromium.
explorer: $(READY)
	@$(BIN)/python docs/explorer.py

# Runs the examples of docs/inverse-rendering.md once, and draws its pictures.
inverse: $(READY)
	@$(BIN)/python docs/inverse.py

# Measures the table and the plot of docs/stability.md: a minute.
stability: $(READY)
	@$(BIN)/python docs/stability.py

# Measures the three scenes of docs/error-vs-time.md: some five minutes. What is in out/study is not measured again.
study: $(READY)
	@$(BIN)/python docs/study.py

# All benchmarks take some minutes; ONLY="floor cold" runs those two, ARGS=--quick tiny sizes, ARGS=--docs writes docs/speed.md,
# where the table of `explain` is one of those.
bench: $(READY)
	@mkdir -p out/bench
	@$(BIN)/phong-bsdf explain scenes/lecture/mirror-floor.xml -o out/bench > /dev/null
	@PYTHONPATH=tests $(BIN)/python -m benchmarks $(ONLY) $(ARGS)

clean:
	rm -rf .venv out

$(READY): pyproject.toml
	@echo "Installing into .venv (once)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' \
	    || { echo "Python 3.10 or newer is needed; say which with: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -m venv .venv \
	    || { rm -rf .venv; echo "This Python has no venv. On Debian and Ubuntu: apt install python3-venv"; exit 1; }
	@$(BIN)/python -m pip install -q --disable-pip-version-check --upgrade 'pip>=25.1'
	@$(BIN)/python -m pip install -q -e . --group test
	@touch $@

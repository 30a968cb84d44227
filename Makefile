# `make demo` and `make test` need python3 (3.10 or newer, with venv) and the package index, nothing else.

PYTHON ?= python3
BIN = .venv/bin
READY = .venv/ready
LECTURE = $(patsubst scenes/lecture/%.xml,out/%.png,$(wildcard scenes/lecture/*.xml))

.PHONY: demo test check bench docs figures study gallery explorer inverse clean

demo: $(LECTURE)
	@echo "The lecture's pictures are in $(CURDIR)/out"

test: $(READY)
	@$(BIN)/python -m pytest

check: $(READY)
	@$(BIN)/python -m pip install -q --group lint
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .

# All benchmarks take some minutes; ONLY="floor cold" runs those two, ARGS=--quick tiny sizes, ARGS=--docs writes docs/speed.md.
bench: $(READY)
	@mkdir -p out/bench
	@$(BIN)/phong-bsdf explain scenes/lecture/mirror-floor.xml -o out/bench > /dev/null
	@PYTHONPATH=tests $(BIN)/python -m benchmarks $(ONLY) $(ARGS)

figures: $(READY)
	@$(BIN)/python docs/figures.py
	@$(BIN)/phong-bsdf render scenes/lecture/mirror-floor.xml -o docs/images/mirror-floor.png --spp 16

# The three scenes of docs/error-vs-time.md: some five minutes. What is in out/study is not measured again.
study: $(READY)
	@$(BIN)/python docs/study.py

gallery: $(READY)
	@$(BIN)/python docs/gallery.py

# The page, and its picture where there is a Chromium.
explorer: $(READY)
	@$(BIN)/python docs/explorer.py

# The pictures of docs/inverse-rendering.md: its examples, run once.
inverse: $(READY)
	@$(BIN)/python docs/inverse.py

docs: figures study gallery explorer

clean:
	rm -rf .venv out

# One picture of two: without falloff above, with it below.
out/falloff.png: scenes/lecture/falloff.xml $(READY)
	@mkdir -p out
	@$(BIN)/phong-bsdf render $< -o out/falloff-without.exr
	@$(BIN)/phong-bsdf render $< -o out/falloff-with.exr -D convention=physical -D intensity=91.6
	@$(BIN)/python -c "import numpy, phong_bsdf.images as i; i.write('$@', \
	    numpy.concatenate([i.read_exr(f'out/falloff-{x}.exr') for x in ('without', 'with')]))"

out/%.png: scenes/lecture/%.xml $(READY)
	@mkdir -p out
	@$(BIN)/phong-bsdf render $< -o $@

$(READY): pyproject.toml
	@echo "Installing into .venv (once)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' \
	    || { echo "Python 3.10 or newer is needed; say which with: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -m venv .venv \
	    || { rm -rf .venv; echo "This Python has no venv. On Debian and Ubuntu: apt install python3-venv"; exit 1; }
	@$(BIN)/python -m pip install -q --disable-pip-version-check --upgrade 'pip>=25.1'
	@$(BIN)/python -m pip install -q -e . --group test
	@touch $@

# The two commands are `make demo` and `make test`; each sets up everything it needs in .venv first.

PYTHON ?= python3
BAG ?=
BIN := .venv/bin
# The ROS wheels' start-up hook leaves this behind; inherited, it would point into another environment.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Where Python must not keep what it compiles (as in many containers), each node would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-bounds coverage lint setup setup-test docs site colcon wheels lock bench bench-check chaos peers clean

help:
	@echo "make demo    replay a recorded robot run through the suite; the report goes to demo-report/"
	@echo "make test    lint, type check and all tests"
	@echo "make test-bounds  the libraries' tests with bounds checks in compiled code"
	@echo "make coverage  how much of the libraries their tests reach, lines and branches; written to bench/coverage.txt"
	@echo "make chaos   generated, mutated and damaged inputs for MINUTES=10 (SEED=1); exit status 1 for any death"
	@echo "make docs    write every figure and generated page anew, from results/ and the sources"
	@echo "make site    build the documentation as a web site, in site/"
	@echo "make colcon  build the workspace with colcon"
	@echo "make wheels  wheels of the product, its experiments and its messages, in dist/"
	@echo "make lock    requirements/lock.txt anew: all that the runtime needs, with hashes, for every Python and machine"
	@echo "make bench   benchmarks; results go to bench/*.txt and bench/ratios.json"
	@echo "make bench-check  processor times beside other libraries'; exit status 1 where a ratio got worse by more than its spread"
	@echo "make peers   an environment for peers that need other versions of libraries, for the experiment peers"
	@echo "make clean   remove .venv and everything generated"

define bootstrap
@command -v $(PYTHON) >/dev/null 2>&1 || { echo "set-up: stopped: $(PYTHON) was not found: install it with 'apt install python3 python3-venv'."; exit 1; }
@$(PYTHON) compat/bootstrap.py $(1)
endef

setup:
	$(call bootstrap,runtime)

setup-test:
	$(call bootstrap,test)

demo: setup
	$(BIN)/whereabouts demo $(if $(BAG),--bag $(BAG))

lint: setup-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Threads of OpenMP that are more than there are cores wait for each other in a loop.
test: lint
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2

# Compiled functions check every index here; what they compile to is kept apart from the ordinary cache.
test-bounds: setup-test
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$(CURDIR)/.venv/numba-bounds $(BIN)/python -m pytest --timeout=1200 $(foreach part,estimation registration loop_closure tracking world_model,test/$(part))

# Of the libraries' lines and branches, those that their tests reach. Compiled functions cannot be watched: they are reached
# in a second run, as plain Python, in which only small cases come to an end and the others are cut off.
LIBRARIES := estimation registration loop_closure tracking world_model
COVER := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 -q --cov-branch --cov-report= $(LIBRARIES:%=--cov=%) $(LIBRARIES:%=test/%)
coverage: setup-test
	$(COVER)
	-NUMBA_DISABLE_JIT=1 $(COVER) --cov-append --tb=no -r N -p bench.cut_off --timeout=0
	@for part in $(LIBRARIES); do printf '%-14s %s %%\n' $$part $$($(BIN)/coverage report --include="$$part/*" --format=total); done \
		| tee bench/coverage.txt

MINUTES ?= 10
SEED ?= 1
chaos: setup-test
	$(BIN)/python -m evaluation.chaos --minutes $(MINUTES) --seed $(SEED)

docs: setup-test
	$(BIN)/python -m evaluation.pages

# With npm the library that draws the diagrams becomes part of the site; without it browsers load it from the network.
MERMAID := mermaid-11.4.1
site:
	$(call bootstrap,site)
	@if [ ! -e .venv/$(MERMAID) ] && command -v npm >/dev/null; then \
		mkdir .venv/$(MERMAID) && npm pack --silent --pack-destination .venv/$(MERMAID) $(subst mermaid-,mermaid@,$(MERMAID)) >/dev/null \
		&& tar -xzf .venv/$(MERMAID)/$(MERMAID).tgz -C .venv/$(MERMAID) --strip-components=2 package/dist/mermaid.min.js \
		&& rm .venv/$(MERMAID)/$(MERMAID).tgz || { rm -rf .venv/$(MERMAID); echo "site: npm could not fetch $(MERMAID)"; }; fi
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "site: open site/index.html"

# The whole workspace as colcon builds it, against the wheels instead of /opt/ros.
colcon: setup-test
	PATH="$(CURDIR)/$(BIN):$$PATH" AMENT_PREFIX_PATH="$(CURDIR)/.venv" $(BIN)/colcon build --base-paths . whereabouts_msgs \
		--cmake-args -G Ninja -DPython3_EXECUTABLE="$(CURDIR)/$(BIN)/python" \
		-DCMAKE_PROJECT_INCLUDE="$(CURDIR)/compat/ros_wheels.cmake"

wheels: setup
	$(BIN)/python compat/wheels.py dist

lock: setup
	$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-header requirements/runtime.txt -o requirements/lock.txt

# Peers that cannot live in one environment with the suite.
peers:
	$(PYTHON) -m venv .venv-peers
	.venv-peers/bin/pip install --disable-pip-version-check -q -r requirements/peers.txt

bench: setup-test
	@for file in bench/bench_*.py; do echo "== $$file"; $(BIN)/python $$file || exit 1; done
	$(BIN)/python bench/ratios.py

bench-check: setup-test
	$(BIN)/python bench/ratios.py --check

clean:
	rm -rf .venv .venv-peers build dist install log site demo-report experiments-out .pytest_cache .mypy_cache .ruff_cache .hypothesis bags/home.mcap bags/killian.mcap
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

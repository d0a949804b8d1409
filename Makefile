# make study   simulate, record, replay and report the four scenes: results/report/index.html
# make campaigns  starts, accuracies and forms, beside a study: more sections of its page
# make outside    other QPs, beside a study: MuJoCo's, families of scenes, in space, IMPORTS="FILE ..."
# make publish study, campaigns, outside, growth, races, criterion …, and what they report into reports/published
# make peers   other physics engines, which it installs, beside a study: reports/published/peers
# make growth  time per QP against its size, up to 20,000 columns: results/growth, …/growth_piles, …
# make bench   work counts against the committed baseline, then times as ratios
# make floors  adapters against the shortest hand-written calls of their packages
# make test    all tests
# make check   those that a person runs while working: under a minute, and it says what it leaves out
# make rounding  the numerically delicate tests once more, rounded as on another processor
# make oldest  all tests with the oldest versions that pyproject.toml allows, in .venv-oldest
# make docs    the documentation as a site, which it installs Sphinx for: site/index.html
# Each makes the virtual environment .venv first if it is missing; Python 3.11 or newer is needed.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
TESTS := pytest -n auto --dist worksteal

FRICTION := results/recordings/fig4.h5 results/recordings/fig5.h5
MODELS := mujoco:arm mujoco:gripper mujoco:pile mujoco:tumbling mujoco:walker
SPARSE := glambda,clarabel,daqp,osqp,piqp,proxqp
SCENES := results/recordings/fig2.h5 results/recordings/fig3.h5 $(FRICTION)

.PHONY: study quick publish campaigns outside families peers growth bench floors test check rounding oldest lint docs clean

study: $(INSTALLED)
	$(BIN)/glambda study

quick: $(INSTALLED)
	$(BIN)/glambda study --quick

publish: study campaigns outside growth
	$(BIN)/glambda race $(SCENES) results/families/*.h5 results/engines/*.h5 -o results/race
	$(BIN)/glambda race results/growth*/recordings/[htwp]*,bodies=[25]0,*.h5 -o results/race_growth
	$(BIN)/glambda criterion $(SCENES) results/families/*.h5 -o results/criterion
	$(BIN)/glambda stability -o results/stability
	$(BIN)/glambda painleve -o results/painleve
	$(BIN)/glambda convergence -o results/convergence
	$(BIN)/glambda closed-loop -o results/closed_loop
	$(BIN)/glambda cases --foils -o results/cases
	$(BIN)/glambda claims --slow -o results/claims
	find reports/published -mindepth 1 -maxdepth 1 ! -name peers -exec rm -rf {} +
	$(BIN)/glambda report results -o reports/published
	COLUMNS=110 $(BIN)/python benchmarks/steps.py > reports/published/steps.txt
	COLUMNS=110 $(BIN)/python -m tests.endurance.processors > reports/published/processors.txt
	find reports/published -name '*.svg' -delete

campaigns: study
	$(BIN)/glambda replay $(FRICTION) --settings paper --solvers glambda,daqp,osqp,proxqp \
	  --arms exact,extrapolated,stale5,stale20,corrupted,bare,shuffled -o results
	$(BIN)/glambda replay $(FRICTION) --settings 1e-2,1e-4,1e-6,1e-8,1e-10 --arms warm \
	  --solvers glambda,clarabel,daqp,highs,osqp,piqp,proxqp,scs -o results
	$(BIN)/glambda stretch results/recordings/fig5.h5 -o results/stretched
	$(BIN)/glambda replay results/stretched/*.h5 --settings high --arms cold \
	  --solvers forms -o results
	$(BIN)/glambda disturb $(FRICTION) -o results/disturbed
	$(BIN)/glambda replay results/disturbed/*.h5 --settings paper --arms cold,warm -o results

families: $(INSTALLED)
	$(BIN)/glambda record tower --set bodies=150 --set speed=0.01 --until 0.3 --overwrite -o results/families
	$(BIN)/glambda record wall --set bodies=200 --set speed=0.01 --until 0.3 --overwrite -o results/families
	$(BIN)/glambda record pyramid --set bodies=105 --set speed=0.01 --until 0.3 --overwrite -o results/families
	$(BIN)/glambda record heap --set bodies=20 --set room=0 --until 0.1 --overwrite -o results/families
	$(BIN)/glambda record tower --set bodies=40 --set speed=0.01 --set mu=0.5 --until 0.3 --overwrite -o results/families
	$(BIN)/glambda record wall --set bodies=12 --set speed=0.01 --set mu=0.3 --until 0.1 --overwrite -o results/families

outside: study families
	$(BIN)/python -m pip install --quiet -e '.[dev,mujoco]'
	$(BIN)/glambda record $(MODELS) --until 1 --overwrite -o results/engines
	$(if $(IMPORTS),$(foreach file,$(IMPORTS),$(BIN)/glambda import $(file) -o results/engines &&) true)
	$(BIN)/glambda replay results/engines/*.h5 --settings high --arms cold,kept,warm -o results \
	  --solvers all,-enumeration
	$(BIN)/glambda replay results/families/*.h5 --settings high --arms cold,kept,warm -o results \
	  --solvers glambda,lotstedt,clarabel,daqp,highs,osqp,piqp,proxqp,scs
	$(BIN)/glambda record space_tower space_tower,mu=0.0 space_pyramid,mu=0.0 \
	  --until 0.1 --fixed-step 0.01 --overwrite -o results/space
	$(BIN)/glambda replay results/space/*.h5 --settings high --arms cold,kept,warm -o results \
	  --solvers all,-enumeration

peers: study
	$(BIN)/python -m pip install --quiet -e '.[dev,peers]'
	$(BIN)/glambda peers --limit 5 -o results/peers \
	  --engines glambda,pymunk,box2d,box2d3,mujoco,dart,drake,bullet
	rm -rf reports/published/peers
	$(BIN)/glambda report results -o reports/published
	find reports/published -name '*.svg' -delete

growth: $(INSTALLED)
	$(BIN)/glambda growth --limit 0.2 -o results/growth
	$(BIN)/glambda growth pyramid heap,mu=0.0 --limit 0.05 --solvers $(SPARSE) \
	  -o results/growth_piles
	$(BIN)/glambda growth tower,mu=0.5 wall,mu=0.5 pyramid,mu=0.5 heap,mu=0.5 --limit 0.05 \
	  --solvers $(SPARSE) -o results/growth_friction
	$(BIN)/glambda growth space_tower,mu=0.0 space_tower,mu=0.5 \
	  --bodies 5,10,20,50,110 --limit 0.05 --solvers $(SPARSE) -o results/growth_space

bench: $(INSTALLED)
	$(BIN)/python benchmarks/work_counts.py
	$(BIN)/python benchmarks/times.py

floors: $(INSTALLED)
	$(BIN)/python -m benchmarks.floors

test: $(INSTALLED)
	$(BIN)/python -m harness.machine.kernels
	$(BIN)/python -m $(TESTS)

check: $(INSTALLED)
	$(BIN)/python -m harness.machine.kernels
	$(BIN)/python -m $(TESTS) -m "not slow"

rounding: $(INSTALLED)
	$(BIN)/python -m tests.endurance.processors --run another -m harness.machine.kernels
	$(BIN)/python -m tests.endurance.processors --run another -m $(TESTS) -m rounding

oldest:
	test -x .venv-oldest/bin/python || $(PYTHON) -m venv .venv-oldest
	sed -n 's/^ *"\([A-Za-z0-9_-]*\)>=\([0-9.]*\)",$$/\1==\2/p' pyproject.toml > .venv-oldest/oldest.txt
	.venv-oldest/bin/python -m pip install --quiet -c .venv-oldest/oldest.txt -e '.[dev]'
	.venv-oldest/bin/python -m harness.machine.kernels
	.venv-oldest/bin/python -m $(TESTS)

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(INSTALLED)
	$(BIN)/python -m pip install --quiet -e '.[dev,docs]'
	$(BIN)/sphinx-build -W -q -b html docs site

$(INSTALLED): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "glambda needs Python 3.11 or newer; '$(PYTHON)' is $$($(PYTHON) --version 2>&1)." >&2; \
	  echo "Name another one, such as: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile -e '.[dev]'
	$(BIN)/python -m compileall -qq -j 0 -x /tests/ $(VENV)/lib || true  # on all cores; pip takes one
	touch $@

clean:
	rm -rf $(VENV) .venv-oldest build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

# Thin: each target is what a person would type.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.stamp
SIM_STAMP := $(VENV)/.sim-stamp
PYTHON_OF_VENV := test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || python3 -m venv $(VENV)
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

# Tests start the programs hundreds of times: without byte code on disk each start compiles them again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: venv demo test test-slow test-unclocked test-clock lint docs bench blind blind-nature blind-moving naming loads golden calibrated conflict certify vcan chaos soak mutants pair pair-full pair-clock follow moving fleet live blackbox space strangers pages package sbom clean

venv: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON_OF_VENV)
	@echo "installing gateway, simulator and test tools into $(VENV): one to four minutes, 2 GB"
	$(INSTALL) -e ".[sim,formats,fleet,dev]"
	touch $(STAMP)

# What the demo needs and no more: half a minute to two, 0.6 GB.
$(SIM_STAMP): pyproject.toml constraints.txt
	$(PYTHON_OF_VENV)
	@echo "installing gateway and simulator into $(VENV): one to two minutes, 0.6 GB"
	$(INSTALL) -e ".[sim]"
	touch $(SIM_STAMP)

demo: $(if $(wildcard $(STAMP)),$(STAMP),$(SIM_STAMP))
	$(BIN)/python -m sim.demo -o out/demo

# Tests in lockstep wait for processes and for the disk: three of them keep two cores busy.
WORKERS ?= 3
TESTS := $(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup --durations=25 --durations-min=5

# Before every commit: the fast suite.
test: venv
	$(TESTS) -m "not slow"

# Before a merge: whole commands, property tests with more examples, and what moves by the clock.
test-slow: test-unclocked test-clock

test-unclocked: venv
	$(TESTS) -m "(slow or hypothesis) and not clock" --hypothesis-profile=slow

# Alone on the machine.
test-clock: venv
	$(BIN)/python -m pytest -m clock $$(grep -rl --include="test_*.py" "mark.clock" tests)

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/codespell -D - -D benchmarks/words.txt
	$(BIN)/python -m benchmarks.language
	$(BIN)/python -m benchmarks.ceilings

# The documentation as pages, in out/docs; a link that leads nowhere fails.
docs: venv
	$(INSTALL) -e ".[docs]"
	$(BIN)/python -m benchmarks.reference
	$(BIN)/python -m mkdocs build --quiet

bench: venv
	$(BIN)/python -m benchmarks.bench --out out/bench

blind: venv
	$(BIN)/python -m benchmarks.blind --out out/blind

# Arms as they stand, by nature's own draws: an hour and more.
blind-nature: venv
	$(BIN)/python -m benchmarks.blind --tier nature --out out/blind-nature

# Arms drawn by nature in motion, each with one unstated mechanism or none: half an hour.
blind-moving: venv
	$(BIN)/python -m benchmarks.moving.blind --out out/blind-moving

# What estimate and diagnose answer to 248 tables, against the stored answer (--store replaces it): a quarter of an hour.
golden: venv
	$(BIN)/python -m benchmarks.golden --out out/golden

# Whether 95 % intervals hold on tables drawn from the stated model itself: ten minutes.
calibrated: venv
	$(BIN)/python -m benchmarks.calibrated --out out/calibrated

# Statements about an arm that are wrong, and right ones: what passes silently, what raises an alarm; ten minutes.
conflict: venv
	$(BIN)/python -m benchmarks.conflict --out out/conflict

# Acceptance of 200 arms, replays, cycle times of 20 paths: half an hour when idle.
certify: venv
	$(BIN)/python -m benchmarks.certify --out out/certify

vcan: venv
	$(BIN)/python tests/vcan/vm.py

chaos: venv
	$(BIN)/python -m benchmarks.chaos --out out/chaos

soak: venv
	$(BIN)/python -m benchmarks.chaos soak --out out/soak

# An hour: 200 small mistakes, each put in and looked for by the tests, the fast suite first.
mutants: venv
	$(BIN)/python -m benchmarks.mutants --out out/mutants

# Names of missing effects: the gateway and five regressions on the same cells, scored by one program.
naming: venv
	$(INSTALL) -e ".[naming]"
	$(BIN)/python -m benchmarks.naming run --seeds test --count 120 --out out/naming

# Loads at rest and in motion: the gateway, plain least squares, FIGAROH and MuJoCo sysid on the same cells; a quarter of an hour on an idle machine.
loads: venv
	$(INSTALL) -e ".[loads]"
	$(BIN)/python -m benchmarks.loads --seeds test --out out/loads

follow: venv
	$(BIN)/python -m benchmarks.follow --out out/follow

# Loads, friction and rotors from motion: three times 1000 arms, two hours on an idle machine.
moving: venv
	$(BIN)/python -m benchmarks.moving --out out/moving

# Many robots over months: an hour and more for 1000 robots whose drifts are all looked for; --analysed 100 looks for fewer.
fleet: venv
	$(BIN)/python -m benchmarks.fleet --out out/fleet

# The live page in a headless Chromium, and runs by the clock with and without it: a quarter of an hour on an idle machine.
live: venv
	$(BIN)/python -m benchmarks.live --out out/live

# Every fault that stops an arm, SIGKILL of the master included: what is beside the recording afterwards; four minutes.
blackbox: venv
	$(BIN)/python -m benchmarks.blackbox --out out/blackbox

# 200 random cells, every planned way looked at by PyBullet: half an hour on an idle machine.
space: venv
	$(BIN)/python -m benchmarks.space --out out/space

# Files as strangers bring them, drawn with fixed seeds: read right, or answered with what to type.
strangers: venv
	$(BIN)/python -m benchmarks.strangers --out out/strangers

# Two arms over PyBullet and twelve CAN drives: main rows on two seeds; all rows on ten seeds, with verdicts.
pair: venv
	$(BIN)/python -m benchmarks.pair --out out/pair

pair-full: venv
	$(BIN)/python -m benchmarks.pair --full --out out/pair-full

# Two arms by the clock, beside the same plant in lockstep: half an hour on an idle machine.
pair-clock: venv
	$(BIN)/python -m benchmarks.pair.clock --out out/pair-clock

# Every report page in a headless Chromium, wide, narrow and on paper; apt-get install chromium chromium-driver poppler-utils.
pages: venv
	$(BIN)/python -m benchmarks.pages --out out/pages

# The wheel, built twice; installed by hashes into an environment of its own; CycloneDX and licences; two minutes.
package sbom: venv
	$(INSTALL) -e ".[package]"
	$(BIN)/python -m benchmarks.package --out out/package

# Pinned packages with their hashes, for `pip install --require-hashes -r requirements.txt`: after a change of a pin.
requirements.txt: pyproject.toml constraints.txt
	$(INSTALL) -e ".[package]"
	$(BIN)/uv pip compile --quiet pyproject.toml -c constraints.txt --generate-hashes --universal --no-header --no-annotate -o $@

clean:
	rm -rf $(VENV) out

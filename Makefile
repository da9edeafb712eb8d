# Everything that people and CI do. `make help` lists it.
VENV   := .venv
BIN    := $(VENV)/bin
EXTRAS ?= rig,lab,dev
comma  := ,
STAMP  := $(VENV)/.extras-$(subst $(comma),-,$(EXTRAS))
SEED   ?= 1
BENCH_VENV := .venv-bench
KERAS_VENV := .venv-bench-keras
CLUSTER_VENV := .venv-cluster
SPEED  ?= lockstep
SCALE  ?= small
CASES  ?= 400
DRAWN  ?= 26
PER_WORLD ?= 5
WORLDS ?= 16
JOBS   ?= 2

.PHONY: help setup demo deploy install-rig rollback-rig wheels test test-slow test-paper test-systemd test-arm64 test-cluster lint format messages docs fuzz kill-uploader fuzz-vision bench bench-vision bench-training discovery discovery-gain discovery-simulators paper guide guide-ends pins clean

help:  ## this list
	@sed -n 's/^\([a-z0-9-]*\):.*## /  make \1\t/p' Makefile | expand -t 24

setup: $(STAMP)  ## make .venv with all that demo and tests need

$(STAMP): pyproject.toml deploy/constraints.txt deploy/make-venv.sh
	@deploy/make-venv.sh $(VENV) '$(EXTRAS)'
	@touch $@

demo: setup  ## grow a virtual bean round an obstacle with all services; result in out/ (SPEED=lockstep|realtime|N, SEED=1)
	@$(BIN)/flora-twin demo --out out --seed $(SEED) --speed $(SPEED)

# What is given to make it hands on in the environment, as it is: a folder's name may hold an apostrophe.
deploy: setup  ## bring a signed controller to a rig (CONTROLLER=file RIG=name, HOST=user@host, CONFIG=flora.toml, SHADOW=ticks)
	@deploy/publish-controller.sh $(BIN)

install-rig: setup  ## install this checkout on a rig over ssh, back to what ran before where it is not well (RIG=user@host)
	@$(BIN)/python deploy/install_rig.py '$(RIG)'

rollback-rig: setup  ## go back to the release that ran before (RIG=user@host)
	@$(BIN)/python deploy/install_rig.py --rollback '$(RIG)'

wheels: setup  ## is there a wheel of each of the rig's packages for a Raspberry Pi?
	@$(BIN)/python deploy/rig_wheels.py

# Some tests wait more than they work: two cores are busy with three files.
test: JOBS = 3
test: setup  ## run the tests, three files at a time (JOBS=3)
	@$(BIN)/python -m pytest --numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder

test-slow: setup  ## the tests that take minutes
	@$(BIN)/python -m pytest -m slow

test-paper: setup  ## the whole paper at its smallest scale, a minute and a half of work
	@$(BIN)/python -m pytest -m slow tests/lab/test_paper_command.py

test-systemd: setup  ## the rig under a real systemd: a Debian tree is booted; needs root, systemd-container and debootstrap
	@$(BIN)/python -m pytest -m slow -s tests/systemd

test-arm64: setup  ## plants, stems and the whole rig on the processor of a Pi 4, emulated; needs root, qemu-user-static and debootstrap
	@$(BIN)/python -m pytest -m slow -rs tests/arm64

test-cluster: $(CLUSTER_VENV)/.made  ## evolution on several Ray nodes of this machine, one of which is killed
	@$(CLUSTER_VENV)/bin/python -m pytest tests/lab/test_evolve_cluster.py tests/lab/test_evolve_crew_on_ray.py

# Ray is for those who have many machines.
$(CLUSTER_VENV)/.made: pyproject.toml deploy/constraints.txt deploy/make-venv.sh
	@deploy/make-venv.sh $(CLUSTER_VENV) rig,lab,cluster,dev
	@touch $@

lint: setup  ## format, lint, types, import contracts
	@$(BIN)/ruff format --check --quiet . && echo "ok  format"
	@$(BIN)/ruff check --quiet . && echo "ok  lint"
	@$(BIN)/mypy --no-error-summary && echo "ok  types"
	@$(BIN)/lint-imports --no-logo 2>/dev/null | grep -q 'Contracts: .* 0 broken' && echo "ok  imports" || { $(BIN)/lint-imports; exit 1; }

format: setup  ## put the code into its form
	@$(BIN)/ruff check --fix --quiet . ; $(BIN)/ruff format --quiet .

messages: setup  ## write the message reference page and JSON Schema from the catalogue
	@$(BIN)/python -m flora_common.messages docs/reference

docs: messages  ## write all pages and pictures that are made from the code: messages, configuration, causes, power budget, box, wiring
	@for script in configuration causes power box wiring; do $(BIN)/python docs/generate/$$script.py || exit 1; done

fuzz: setup  ## a million malformed frames against the services
	@FLORA_FUZZ=1000000 $(BIN)/python -m pytest tests/rig/test_bus_fuzz.py

fuzz-vision: setup  ## ten thousand damaged pictures against the stem finder (FUZZ='--pictures N --list')
	@$(BIN)/python tests/bench/fuzz_vision.py $(FUZZ)

kill-uploader: setup  ## kill the uploader at every system call of a transfer
	@FLORA_KILL_ALL=1 $(BIN)/python -m pytest -s tests/rig/test_uploader_kill.py

bench: setup  ## the benchmarks: latency, throughput, memory, idle load
	@for file in $(sort $(wildcard tests/bench/bench_*.py)); do echo "== $$file"; $(BIN)/python $$file || exit 1; done

bench-vision: setup $(BENCH_VENV)/.made  ## stem finders against known truth, PlantCV and scikit-image too (BENCH='--full --json FILE --pictures DIR')
	@$(BIN)/python tests/bench/bench_vision.py $(BENCH)

# PlantCV and scikit-image never share an environment with the rig.
$(BENCH_VENV)/.made: tests/bench/vision/requirements.txt
	@$(BIN)/python -m venv $(BENCH_VENV)
	@$(BENCH_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --requirement $<
	@$(BENCH_VENV)/bin/python -c 'import cv2' || { echo "make bench-vision: PlantCV's OpenCV needs: sudo apt install libgl1 libglib2.0-0" >&2; exit 2; }
	@touch $@

bench-training: setup $(KERAS_VENV)/.made  ## seconds per epoch of both recipes beside Keras (BENCH='--repeats 9 --json FILE')
	@$(BIN)/python tests/bench/bench_training.py $(BENCH)

# Keras and TensorFlow never share an environment with the rig.
$(KERAS_VENV)/.made: tests/bench/training/requirements.txt
	@$(BIN)/python -m venv $(KERAS_VENV)
	@$(KERAS_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --requirement $<
	@touch $@

discovery: setup  ## hide effects in drawn runs, see whether they are named, print the table (CASES=400 FIRST=60 SEED=1 JOBS=2 PER_WORLD=5 ONLY=sag,draught)
	@$(BIN)/python -m tests.discovery.cases --cases $(CASES) --seed $(SEED) --jobs $(JOBS) --per-world $(PER_WORLD) $(if $(FIRST),--first $(FIRST)) $(if $(ONLY),--effects $(ONLY)) --results out/discovery/$(SEED)-$(CASES).jsonl --markdown out/discovery/$(SEED)-$(CASES).md

discovery-gain: setup  ## what naming hidden effects is worth to controllers; an hour (DRAWN=26 SEED=1 KINDS='feedback plan' ORACLE=1)
	@$(BIN)/python -m tests.discovery.controllers --cases $(DRAWN) --seed $(SEED) $(if $(KINDS),--kinds $(KINDS)) $(if $(ORACLE),--oracle) --results out/discovery/controllers-$(SEED)-$(DRAWN).jsonl --markdown out/discovery/controllers-$(SEED)-$(DRAWN).md

discovery-simulators: setup  ## hide wrong clocks and missing memories in simulators of drawn worlds, count what is told; an hour (WORLDS=16 SEED=1 JOBS=2)
	@$(BIN)/python -m tests.discovery.simulators --worlds $(WORLDS) --seed $(SEED) --jobs $(JOBS) --results out/discovery/simulators-$(SEED).jsonl

paper: setup  ## the whole paper beside ours, in out/paper (SCALE=smoke|small|full, SEED=1); goes on where it was stopped
	@$(BIN)/flora-lab paper --scale $(SCALE) --seed $(SEED) -o out/paper

guide: setup  ## make the network that tells stems and apices anew, in out/guide: five hours, or minutes with a graphics card; goes on where it was stopped
	@$(BIN)/python tests/guide --out out/guide --jobs $(JOBS)

guide-ends: setup  ## make the perceptron that tells how far off ends are anew, in out/ends: an hour; goes on where it was stopped
	@$(BIN)/python tests/guide/ends.py --out out/ends --jobs $(JOBS)

pins:  ## write deploy/constraints.txt from the environment (first: make setup EXTRAS=rig,lab,cluster,dev)
	@{ echo "# The versions that flora is tested with, all extras. \`make pins\` writes it from an environment that has them all."; \
	   $(BIN)/python -m pip freeze --exclude-editable; } > deploy/constraints.txt

clean:  ## remove the environment and all results
	rm -rf $(VENV) $(BENCH_VENV) $(KERAS_VENV) $(CLUSTER_VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache

# make demo   a robot in a simulated room, driven by clicks: HEADLESS=1 sets the goal itself, SEED=n picks the room,
#             PLANNER=bev plans without the learnt policy
# make check  format, lint, types, architecture
# make test   all tests but the slow ones, JOBS=2 at a time (eight minutes)
# make test-training   the slow tests of training and export (ten minutes); make test-slow has all that are slow
# make test-network   a robot and a server on two hosts whose network, server, router and disk fail (three minutes; as root)
# make test-guides   the long commands of the guides, as printed (three minutes); make test runs the short ones
# make browser   installs Chromium (Debian, as root), without which the tests of the page are skipped
# make wheels   builds the four packages into dist/; make test-wheels installs them from there into a new environment and runs them
# make bandit   looks for insecure code; make audit also asks PyPI for known vulnerabilities of what constraints.txt pins
# make api-docs   writes docs/api.md
# make soak   random goals and random faults for half an hour: MINUTES=n, SEED=n; the report goes to out/soak
# make network   installs iproute2 (Debian, as root), without which the tests across several hosts are skipped
# make images-test   builds the container images from Debian's packages and runs the demo in them (as root, on Debian 12)
# make notice   writes NOTICE: what the images contain, and under which licences
# make train  makes data and trains the edge models from nothing (three hours on two cores), into runs/

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt
SEED ?= 0
MINUTES ?= 30
JOBS ?= 2
TRAIN := $(BIN)/revnm-train

.PHONY: test-network demo check format test test-training test-wheels test-slow browser wheels bandit audit api-docs soak network test-guides images images-test notice train clean

demo: $(VENV)/run.stamp
	$(BIN)/revnm-sim demo --seed $(SEED) $(if $(HEADLESS),--headless) $(if $(PLANNER),--planner $(PLANNER))

check: $(VENV)/dev.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/dev.stamp
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# A file's tests stay in one process: they share what is costly to set up.
test: $(VENV)/dev.stamp
	$(BIN)/pytest --quiet --numprocesses $(JOBS) --dist loadfile

test-training: $(VENV)/dev.stamp
	$(BIN)/pytest --quiet -m slow tests/training tests/sim/test_engine.py

test-wheels: $(VENV)/dev.stamp wheels
	$(BIN)/pytest --quiet -m slow tests/system/test_wheels.py

test-network: $(VENV)/dev.stamp network
	$(BIN)/pytest --quiet -m slow tests/system/test_network_faults.py tests/system/test_two_servers.py

test-guides: $(VENV)/dev.stamp
	$(BIN)/pytest --quiet -m slow tests/system/test_guides.py

test-slow: $(VENV)/dev.stamp wheels
	$(PIP) --group slow
	$(BIN)/pytest --quiet -m slow

browser:
	command -v chromium >/dev/null || { apt-get update -qq && apt-get install -y -qq --no-install-recommends chromium fonts-dejavu-core; }

wheels: $(BIN)/python
	rm -f dist/revnm_*.whl
	$(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps --build-constraint constraints.txt --wheel-dir dist \
	    ./robot_client ./server ./sim ./training

bandit: $(VENV)/dev.stamp
	$(PIP) --group audit
	$(BIN)/bandit --quiet --configfile pyproject.toml --severity-level medium --recursive robot_client server sim training

# Strict: a package that could not be looked up is an error, not a package without fault.
audit: bandit
	$(BIN)/pip-audit --strict --no-deps --disable-pip --requirement constraints.txt

api-docs: $(VENV)/dev.stamp
	$(BIN)/python docs/api_reference.py > docs/api.partial
	mv docs/api.partial docs/api.md

soak: $(VENV)/run.stamp
	$(BIN)/revnm-sim soak --minutes $(MINUTES) --seed $(SEED) --out out/soak

network:
	command -v ip >/dev/null || { apt-get update -qq && apt-get install -y -qq --no-install-recommends iproute2; }

images:
	command -v podman >/dev/null && command -v mmdebstrap >/dev/null && [ -d /usr/lib/cni ] || { apt-get update -qq && \
	    apt-get install -y -qq --no-install-recommends podman crun conmon containernetworking-plugins iptables iproute2 mmdebstrap; }
	tests/docker/build.sh

images-test: $(VENV)/dev.stamp images
	$(PIP) --group images
	$(BIN)/pytest --quiet -m slow tests/docker/test_accelerators.py
	tests/docker/apart.sh $(BIN)/pytest --quiet -m slow tests/docker --ignore tests/docker/test_accelerators.py

notice: images
	tests/docker/apart.sh $(PYTHON) docker/notice.py

train: $(VENV)/dev.stamp
	$(TRAIN) synth --episodes 6000 --seed 20 --out data/edge --jobs $(JOBS)
	$(TRAIN) depth --cache data/pictures --out runs/depth --pictures 10000 --steps 1100 --resume
	$(TRAIN) exo2ego --data data/edge --cache data/samples --out runs/exo2ego --steps 600 --resume
	$(TRAIN) policy --data data/edge --cache data/samples --exo2ego runs/exo2ego/last.pt --out runs/policy --steps 2200 --resume
	$(TRAIN) dagger --data data/edge --cache data/samples --exo2ego runs/exo2ego/last.pt --policy runs/policy/last.pt \
	    --depth runs/depth/last.pt --rounds 1 --rollouts 60 --steps 2000 --perception models --seed 500 --out runs/dagger
	$(TRAIN) export --depth runs/depth/last.pt --exo2ego runs/exo2ego/last.pt --policy runs/dagger/round_1/policy/last.pt --out runs/edge

clean:
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .import_linter_cache

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check "pip==26.3"

# What the demo needs: no torch.
$(VENV)/run.stamp: $(BIN)/python constraints.txt robot_client/pyproject.toml server/pyproject.toml sim/pyproject.toml
	$(PIP) --editable robot_client --editable server --editable sim
	touch $@

# What the tests and the training need.
$(VENV)/dev.stamp: $(VENV)/run.stamp training/pyproject.toml pyproject.toml
	$(PIP) --editable robot_client --editable server --editable sim --editable training --group dev
	touch $@

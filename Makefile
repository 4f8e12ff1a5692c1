# Two commands do everything on a fresh machine: `make demo` and `make test`. `make help` lists the rest.
# The logic of the set-up is in ros2_ws/bootstrap; PYTHON=/path/to/python3.12 chooses the Python.
SHELL := /bin/sh
PYTHON ?=
BIN := .venv/bin
PYTEST := $(BIN)/python -m pytest

.DEFAULT_GOAL := help
.PHONY: help setup extras demo test test-long lint format lock clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 20

setup: ## virtual environment, locked packages, interface packages; quick when nothing changed
	@python=$$(PYTHON='$(PYTHON)' sh ros2_ws/find_python.sh) && cd ros2_ws && "$$python" -B -m bootstrap

extras: setup ## optional packages: reading STEP files, peers of the benchmarks
	$(BIN)/python -m pip install --no-input --progress-bar off --disable-pip-version-check --no-deps --require-hashes \
		-r requirements/lock-extras.txt

demo: setup ## measure sample part scene4 on the mock cell
	$(BIN)/skinplan run scene4

lint: setup ## style, format, types, wall between library and ROS
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The unit tests run once, one process per core, in which neither rclpy nor any message package can be imported. Tests of nodes run in
# two processes, each test in a ROS domain of its own; those of the whole graph one after the other. Everything runs
# even if something before it failed, and pytest has the last word. Properties get the same examples each time; new ones in `make test-long`.
test: setup ## all checks but the long ones
	@status=0; \
	$(MAKE) --no-print-directory lint || status=1; \
	$(PYTEST) tests/unit --without-ros -m "not long" -n auto --dist worksteal --hypothesis-profile=ci || status=1; \
	$(PYTEST) tests/conversions tests/nodes -m "not long" -n 2 --dist loadfile || status=1; \
	$(PYTEST) tests/system -m "not long" || status=1; \
	exit $$status

test-long: setup ## the long checks
	@status=0; \
	$(PYTEST) tests/unit --without-ros -m long -n auto --dist worksteal; case $$? in 0|5) ;; *) status=1 ;; esac; \
	$(PYTEST) $$(grep -l "^from hypothesis" tests/unit/*.py) --without-ros -m "not long" -n auto --dist worksteal || status=1; \
	$(PYTEST) tests/conversions tests/nodes tests/system -m long; case $$? in 0|5) ;; *) status=1 ;; esac; \
	exit $$status

format: setup ## bring the code into the checked format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lock: ## choose the newest versions of all packages anew (needs uv)
	sh requirements/lock.sh

clean: ## remove all that `make setup`, runs and tests made, but not runs/
	rm -rf .venv .venv-old ros2_ws/build ros2_ws/install ros2_ws/log ros2_ws/.setup.lock
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis skinplan_nodes/*.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

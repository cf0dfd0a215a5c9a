# make run        sets up what is missing and shows a valve at work on ROS 2 topics
# make shell      opens a shell in which valve-sim and the nodes are found
# make test       checks and tests: five minutes on two cores
# make test-long  the long tests: documentation, fuzzing, faults, a fleet, printed commands, ROS 2 Kilted, a slice of the campaign
# make golden     writes test/golden anew: what is said of the shipped recordings; read the diff
# make docs       builds the documentation: build/docs/index.html
#
# Where a ROS 2 is sourced it is used as it is; elsewhere the wheels of Jazzy are installed into .venv.
# BASE_PYTHON=/path/to/python3 chooses the interpreter (3.10 to 3.14).

SHELL := /bin/bash
export BASE_PYTHON
# The matrices of a fit are thin: threads of the linear algebra would wait for each other.
export OPENBLAS_NUM_THREADS := 1

ifeq ($(shell tools/environment sourced),)
ENVIRONMENT := .venv
RUN_EXTRAS := ros
TEST_EXTRAS := ros,test,docs
KILTED := kilted
# What another ROS left in this terminal would be mixed into the wheels'.
unexport PYTHONPATH LD_LIBRARY_PATH AMENT_PREFIX_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
else
ENVIRONMENT := .venv-sourced-$(ROS_DISTRO)
RUN_EXTRAS :=
TEST_EXTRAS := test,docs
KILTED :=
endif
PYTHON := $(ENVIRONMENT)/bin/python
KILTED_PYTHON := .venv-kilted/bin/python

# What an environment is made from, and what is compiled into its cache.
DECLARED := setup.py setup.cfg package.xml pyproject.toml tools/environment
COMPILED := valve_sim/warm.py $(shell find valve_sim/model -name '*.py')

# Parts of a test run side by side, two at a time, and each to its end whatever another one finds.
PARTS := $(MAKE) --no-print-directory --keep-going --jobs 2 --output-sync=target
PARTS_ARE := two parts at a time; what each found is printed when it is done, and those that failed are named in the end
PYTEST := -m pytest --durations 10
# Two processes, each with whole files and with all files that share something costly (see test/conftest.py), so that it is
# made once. Live nodes wait most of the time; each process of their tests has a ROS domain of its own.
SIDE_BY_SIDE := --numprocesses 2 --dist loadfile
WITH_NODES = $(shell grep --recursive --files-with-matches --include='test_*.py' 'mark\.ros' test)
# The tests that depend on the ROS distribution.
KILTED_TESTS := $(foreach name,messages receiving node_clock tables valve_node identification_node monitor_node \
	station supervision refusals,test/nodes/test_$(name).py)

.PHONY: run shell test test-long golden compiled docs nodes tests lint types layers long-nodes long-tests campaign kilted
.DELETE_ON_ERROR:

run: $(ENVIRONMENT)/.warm
	$(PYTHON) -m valve_sim.demo

shell: $(ENVIRONMENT)/.warm
	@tools/environment shell $(ENVIRONMENT)

test: $(ENVIRONMENT)/.ready-to-test
	@echo "$(PARTS_ARE)"
	@$(PARTS) nodes lint types layers tests

test-long: $(ENVIRONMENT)/.ready-to-test $(KILTED:%=.venv-%/.ready-to-test)
	-@$(MAKE) --silent --no-print-directory $(ENVIRONMENT)/.warm-with-gas $(KILTED:%=.venv-%/.warm)
	@echo "$(PARTS_ARE)"
	@$(PARTS) long-nodes docs long-tests $(KILTED) campaign

nodes tests long-nodes long-tests campaign: compiled
kilted: .venv-kilted/.warm

golden: $(ENVIRONMENT)/.ready-to-test
	$(PYTHON) test/golden_table.py

# Beside the parts that need no compiled code. Where this fails, the tests run all the same, and say what is wrong.
compiled:
	-@$(MAKE) --silent --no-print-directory $(ENVIRONMENT)/.warm-with-gas

# A warning is an error; stubs and pages of modules that have gone would be warned of, or stay.
docs: $(ENVIRONMENT)/.ready-to-test
	@rm -rf docs/reference/api build/docs
	$(PYTHON) -m sphinx -W --keep-going -q -j 2 -d build/docs-doctrees docs build/docs
	@echo "documentation: build/docs/index.html"

lint:
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m codespell_lib
	$(PYTHON) -m proselint check README.md QUALITY_DECLARATION.md docs/*.md docs/*/*.md

types:
	$(PYTHON) -m mypy

layers:
	$(ENVIRONMENT)/bin/lint-imports

tests:
	$(PYTHON) $(PYTEST) $(SIDE_BY_SIDE) -m "not ros and not long"

nodes:
	$(PYTHON) $(PYTEST) $(SIDE_BY_SIDE) -m "ros and not long" $(WITH_NODES)

long-tests:
	$(PYTHON) $(PYTEST) $(SIDE_BY_SIDE) -m "not ros and long"

long-nodes:
	$(PYTHON) $(PYTEST) -m "ros and long" $(WITH_NODES)

kilted:
	$(KILTED_PYTHON) $(PYTEST) -m "not any_distribution" $(KILTED_TESTS)

campaign:
	$(PYTHON) -m benchmarks.campaign --slice

# A tested environment can run too, so that whoever ran the tests first waits no second time.
RUN_READY := $(firstword $(wildcard $(ENVIRONMENT)/.ready-to-test) $(ENVIRONMENT)/.ready-to-run)

# What is compiled belongs to the sources of the model: others, as a pull brings them, are compiled here and now.
$(ENVIRONMENT)/.warm: $(COMPILED) $(RUN_READY)
	@$(PYTHON) -m valve_sim.warm
	@touch $@

# Tests of valves with gas run in many processes, each of which would compile it at once.
$(ENVIRONMENT)/.warm-with-gas: $(ENVIRONMENT)/.warm
	@$(PYTHON) -m valve_sim.warm --gas
	@touch $@

.venv-kilted/.warm: $(COMPILED) .venv-kilted/.ready-to-test
	@$(KILTED_PYTHON) -m valve_sim.warm
	@touch $@

$(ENVIRONMENT)/.ready-to-run: $(DECLARED)
	@tools/environment make $(ENVIRONMENT) "$(RUN_EXTRAS)"
	@touch $@

$(ENVIRONMENT)/.ready-to-test: $(DECLARED)
	@tools/environment make $(ENVIRONMENT) "$(TEST_EXTRAS)"
	@touch $@

.venv-kilted/.ready-to-test: $(DECLARED)
	@tools/environment make .venv-kilted "ros-kilted,checks"
	@touch $@

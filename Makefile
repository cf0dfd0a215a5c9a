# make run    sets up what is missing and shows a valve at work on ROS 2 topics
# make shell  opens a shell in which valve-sim and the nodes are found
# make test   runs all checks and tests
# make docs   builds the documentation: build/docs/index.html
#
# Where a ROS 2 is sourced it is used as it is; elsewhere the wheels of Jazzy are installed into .venv.
# BASE_PYTHON=/path/to/python3 chooses the interpreter (3.10 to 3.13).

SHELL := /bin/bash
COMMA := ,
export BASE_PYTHON

SOURCED_ROS := $(shell tools/environment sourced)
ifeq ($(SOURCED_ROS),)
ENVIRONMENT := .venv
RUN_EXTRAS := ros
# What another ROS left in this terminal would be mixed into the wheels'.
unexport PYTHONPATH LD_LIBRARY_PATH AMENT_PREFIX_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
else
ENVIRONMENT := .venv-sourced-$(ROS_DISTRO)
RUN_EXTRAS :=
endif
KILTED_ENVIRONMENT := .venv-kilted

PYTHON := $(ENVIRONMENT)/bin/python
KILTED_PYTHON := $(KILTED_ENVIRONMENT)/bin/python
# Live nodes want the cores when something comes, and so does killing processes as they write: one after the other, ahead
# of all else. They mostly wait; the other checks take what they leave: UNHURRIED. There belong the nodes' parts, which are
# tested without ROS, and what a node refuses.
SHARING := command_safety dds_profiles diagnostics encoded_messages handing_on live_map live_valve messages parameters profile_playing realtime refusals replay starting
ALONE := $(filter-out $(SHARING:%=test/nodes/test_%.py),$(sort $(wildcard test/nodes/test_*.py))) \
	$(foreach name,demo documents faults,test/test_$(name).py)
# What hangs on the ROS distribution; faults, fuzz and examples are tested once, on Jazzy, and so is what these files mark
# `any_distribution`: fits, isolation, maps, entry points and values that the nodes refuse, the same code on either.
KILTED_TESTS := $(foreach name,messages encoded_messages receiving valve_node identification_node monitor_node station supervision refusals,test/nodes/test_$(name).py)
# Live nodes are tested again by themselves where they fail, and named for it: tools/retest.py says why.
RETEST := tools/retest.py
export UNSTEADY_TESTS := $(CURDIR)/build/unsteady_tests.txt
DECLARED := setup.py setup.cfg package.xml tools/environment
# The environments are installed side by side: one waits for the network while the other unpacks. What one has compiled
# the other finds.
SETS_UP := $(MAKE) --no-print-directory --jobs 2
# Each command's output comes when the command is done, or the two would be mixed.
SIDE_BY_SIDE := $(MAKE) --no-print-directory --jobs 2 --output-sync=line
# The matrices of a fit are thin: threads of the linear algebra would wait for each other.
export OPENBLAS_NUM_THREADS := 1
# The lowest priority: whoever else has work goes first, as if alone.
UNHURRIED := nice -n 19

# A tested environment can run too, so that whoever ran the tests first waits no second time.
RUN_READY := $(firstword $(wildcard $(ENVIRONMENT)/.ready-to-test) $(ENVIRONMENT)/.ready-to-run)

# What is compiled belongs to the sources of the model: others, as a pull brings them, are compiled here and now, and not
# by the first command.
WARM := $(ENVIRONMENT)/.warm
COMPILED := valve_sim/warm.py $(shell find valve_sim/model -name '*.py')

.PHONY: run shell test check docs compiled nodes kilted-nodes nodes-on-both all-but-nodes
.DELETE_ON_ERROR:

run: $(WARM)
	$(PYTHON) -m valve_sim.demo

shell: $(WARM)
	@tools/environment shell $(ENVIRONMENT)

ifeq ($(SOURCED_ROS),)
test:
	@rm -f $(UNSTEADY_TESTS)
	@$(SETS_UP) $(ENVIRONMENT)/.ready-to-test $(KILTED_ENVIRONMENT)/.ready-to-test
	@echo "tests of live nodes, and beside them all other checks, last in priority; each says what it found in the end"
	@$(SIDE_BY_SIDE) nodes-on-both all-but-nodes
	@! test -e $(UNSTEADY_TESTS) || cat $(UNSTEADY_TESTS)
else
test:
	@rm -f $(UNSTEADY_TESTS)
	@$(MAKE) --no-print-directory check
	@! test -e $(UNSTEADY_TESTS) || cat $(UNSTEADY_TESTS)
	@echo "tested with the sourced ROS 2 $(ROS_DISTRO); in a terminal without ROS, make test tests Jazzy and Kilted"
endif

check:
	@$(SIDE_BY_SIDE) nodes all-but-nodes

# One after the other: nodes of both distributions at once would hold each other up.
nodes-on-both: compiled
	@$(MAKE) --no-print-directory nodes
	@$(MAKE) --no-print-directory kilted-nodes

compiled: $(ENVIRONMENT)/.ready-to-test
	$(PYTHON) -m valve_sim.warm

nodes: compiled
	$(PYTHON) $(RETEST) $(ALONE)

all-but-nodes: compiled
	$(UNHURRIED) $(PYTHON) -m ruff check .
	$(UNHURRIED) $(PYTHON) -m ruff format --check .
	$(UNHURRIED) $(PYTHON) -m mypy
	$(UNHURRIED) $(ENVIRONMENT)/bin/lint-imports
	@$(UNHURRIED) $(MAKE) --no-print-directory docs
	$(UNHURRIED) $(PYTHON) -m pytest --numprocesses auto --maxprocesses 4 --dist worksteal $(addprefix --ignore=,$(ALONE))
	$(UNHURRIED) $(PYTHON) -m benchmarks.campaign --slice

# A warning is an error; stubs and pages of modules that have gone would be warned of, or stay.
docs: $(ENVIRONMENT)/.ready-to-test
	@rm -rf docs/reference/api build/docs
	$(PYTHON) -m sphinx -W --keep-going -q -j 2 -d build/docs-doctrees docs build/docs
	@echo "documentation: build/docs/index.html"

kilted-nodes: $(KILTED_ENVIRONMENT)/.ready-to-test
	$(KILTED_PYTHON) -m valve_sim.warm
	$(KILTED_PYTHON) $(RETEST) $(KILTED_TESTS) -m 'not any_distribution'

$(WARM): $(RUN_READY) $(COMPILED)
	@$(PYTHON) -m valve_sim.warm
	@touch $@

$(ENVIRONMENT)/.ready-to-run: $(DECLARED)
	@tools/environment make $(ENVIRONMENT) "$(RUN_EXTRAS)"
	@$(PYTHON) -m valve_sim.warm
	@touch $@ $(WARM)

$(ENVIRONMENT)/.ready-to-test: $(DECLARED)
	@tools/environment make $(ENVIRONMENT) "$(if $(RUN_EXTRAS),$(RUN_EXTRAS)$(COMMA))test,docs"
	@$(PYTHON) -m valve_sim.warm
	@touch $@ $(WARM)

$(KILTED_ENVIRONMENT)/.ready-to-test: $(DECLARED)
	@tools/environment make $(KILTED_ENVIRONMENT) "ros-kilted,checks"
	@touch $@

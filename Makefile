# The front door: each target does all the set-up it needs. README.md says what they are for.
# The board of the demo, and all that tools/setup prepares for; for any other it is asked for all.
DEMO := qemu-armv7
MACHINE ?= $(DEMO)
BIN := .venv/bin
# How many tests run beside one another; without it tools/test decides.
TEST := tools/test $(if $(WORKERS),-n $(WORKERS))
# Tests and the programs that they start find their modules compiled, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: quick demo test test-fast fuzz soak test-slow test-why test-archive test-boards test-compilers test-kernel test-ros2 test-topologies test-yocto lock lint docs limits coverage mutants bench setup setup-demo board suites clean

# quick, demo and test are names of programs in tools/; make quick DEADLINE=500us for another deadline.
quick:
	@tools/quick --deadline $(or $(DEADLINE),1ms)

demo:
	@MACHINE=$(MACHINE) tools/demo

test:
	@$(TEST)

# What needs no board, no ROS master and no BitBake: for the loop of change and test.
test-fast:
	@$(TEST) -m "not kernel and not slow and not boards and not qemu and not ros and not bitbake"

# What takes long (forty minutes): each load of conditions.yml for two and a half minutes beside a suite, ten nodes that are
# observed for ten minutes, a reset, a power cut and campaigns with a goal on the emulated board, a labgrid farm, and a
# systemd that starts nights.
test-slow: setup
	$(BIN)/pytest -m slow

# Every machine of `rtgen board machines`, booted and measured on: some minutes each, more when they are built first.
test-boards: setup
	$(BIN)/pytest -m boards

# The suites on two releases of ROS 2, of PyPI's wheels, and on a ROS 2 of this machine, PREFIX, as /opt/ros/jazzy.
test-ros2: setup
	RT_TESTS_ROS2=$(abspath $(PREFIX)) $(BIN)/pytest tests/suites/test_ros2.py

# Builds the kernel (five minutes on two idle cores) unless one of the same inputs is in the cache, and boots it.
test-kernel: setup
	$(BIN)/pytest -m "kernel and not slow and not boards"

# The suites, by the compilers of Yocto's releases and without a warning, for Debian 12's ROS and Debian 13's; what they
# build measures on the emulated board. Four cross compilers are downloaded and unpacked into the cache (0.8 GB).
test-compilers: setup
	$(BIN)/pytest tests/suites/compilers.py

# A profile against the real layers: DIR holds checkouts of its repositories (docs/layer.md).
test-yocto: setup
	RT_TESTS_LAYERS=$(abspath $(LAYERS)) $(BIN)/pytest -s tests/bitbake/real_*.py

# Mutated files for every reader of tests/hostile/fuzz.py: SECONDS of them, from SEED on.
fuzz: setup
	PYTHONPATH=runner:tests $(BIN)/python tests/hostile/fuzz.py --seconds $(or $(SECONDS),3600) --seed $(or $(SEED),1)

# A campaign of RUNS through FAULTS (kills, stops, hang-ups, cut links, full disks, damaged files), drawn by SEED; and
# CAMPAIGNS on BOARDS of a labgrid farm of which a part is killed KILLS times.
soak: setup
	SEED=$(SEED) RUNS=$(RUNS) FAULTS=$(FAULTS) $(BIN)/pytest -s tests/hostile/soak.py
	SEED=$(SEED) BOARDS=$(BOARDS) CAMPAIGNS=$(CAMPAIGNS) KILLS=$(KILLS) $(BIN)/pytest -s tests/hostile/lab_soak.py

# Culprits planted on this machine and on both kernels of the emulated board, which rtrun why must name; writes the tables
# of docs/causes.md. Root, an hour and a half; PLACES=here for this machine alone.
test-why: setup
	for place in $(or $(PLACES),here rt standard); do \
	    PYTHONPATH=runner:tests $(BIN)/python tests/why/planted.py --place $$place || failed=1; \
	done; test -z "$$failed"

# The graphs of irobot-ros/ros2-performance, whose folder irobot_benchmark/topology DIR is, are read whole.
test-topologies: setup
	TOPOLOGIES=$(abspath $(or $(DIR),$(error give DIR=, its folder irobot_benchmark/topology))) $(BIN)/pytest tests/rtrun/plan/others_topologies.py

# What docs/archive.md asks polars and a Dask cluster of an archive, an archive in object storage, and what Prometheus makes of
# a site. Installs these beside the tests; Debian's packages of Prometheus are unpacked below build/.
test-archive: setup
	$(BIN)/pip install --quiet 'polars>=1.0' 'dask[dataframe,distributed]>=2024.8' 's3fs>=2024.2' 'moto[server,s3]>=5'
	mkdir -p build/prometheus && cd build/prometheus && apt-get -q download prometheus prometheus-node-exporter && \
	    for package in *.deb; do dpkg -x $$package .; done
	$(BIN)/pytest -s tests/rtrun/archive/other_programs.py tests/rtrun/archive/object_storage.py tests/rtrun/archive/prometheus.py

# The Python packages of `tools/setup dev`, with hashes: of each the newest version that is for Python 3.11 and every newer one.
# And the wheels of ROS 2 for tests, without what only its programs in Python need.
NOT_OF_ROS := empy lark-parser numpy pyyaml setuptools typing-extensions
lock: setup
	$(BIN)/pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --extra dev --universal --fork-strategy fewest --python-version 3.11 \
	    --generate-hashes --upgrade --no-annotate --quiet --custom-compile-command "make lock" --output-file tools/python-packages.txt
	for distro in kilted jazzy; do \
	    $(BIN)/uv pip compile tests/ros2/$$distro.in --universal --python-version 3.11 --generate-hashes --upgrade \
	        $(addprefix --no-emit-package ,$(NOT_OF_ROS)) \
	        --no-annotate --quiet --custom-compile-command "make lock" --output-file tests/ros2/$$distro.txt || exit; \
	done

# The site of docs/, in build/docs: a link to a page, heading or picture that is not there is an error. In seconds.
docs: setup
	$(BIN)/sphinx-build -q --fail-on-warning --keep-going --doctree-dir build/doctrees docs build/docs

# The table of limits in docs/security.md, from the code: a test refuses another.
limits: setup
	PYTHONPATH=runner:tests $(BIN)/python tests/limits.py

# Sentences that have to be read twice, too: tests/words.tsv.
lint: docs
	$(BIN)/python tests/words.py
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The error rates of verdicts, simulated at length and written into docs/coverage.md; `make test` has a short version. Then
# machines drawn at random, for HOURS (8), into the same page: the next call continues, and a partial run says so there.
coverage: setup
	PYTHONPATH=runner:tests nice -n 5 $(BIN)/python tests/coverage/simulate.py
	PYTHONPATH=runner:tests nice -n 5 $(BIN)/python tests/coverage/years.py
	PYTHONPATH=runner:tests nice -n 5 $(BIN)/python tests/coverage/machines.py --hours $(or $(HOURS),8)

# NUMBER mutants (300), drawn by SEED, of the rooms that decide: do tests notice a wrong constant or comparison?
mutants: setup
	$(BIN)/pip install --quiet 'coverage>=7'
	$(BIN)/python tests/mutants.py --seed $(or $(SEED),1) --number $(or $(NUMBER),300)

bench: setup
	nice -n 5 $(BIN)/python tests/bench/bench_analysis.py --check
	$(BIN)/pytest -q -s tests/bench/overhead.py tests/bench/sampler.py
	$(BIN)/pytest -q -s tests/bench/pulling.py tests/bench/farm.py
	nice -n 5 $(BIN)/python tests/bench/archived_year.py
	PYTHONPATH=runner:tests:tests/rtrun nice -n 5 $(BIN)/python tests/bench/lab_month.py
	PYTHONPATH=tests/rtrun $(BIN)/pytest -q -s tests/bench/causes.py tests/bench/flows.py
	PYTHONPATH=tests $(BIN)/pytest -q -s tests/bench/observe.py

setup:
	@tools/setup dev

setup-demo:
	@tools/setup $(if $(filter $(DEMO),$(MACHINE)),,all)

board: setup-demo
	$(BIN)/rtgen board build --machine $(MACHINE)

suites: setup-demo
	$(BIN)/rtgen suites build --machine $(MACHINE)

clean:
	rm -rf build results .venv

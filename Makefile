# make demo                 reconstruct the sample site: demo/tulou/*.blend and *.png
# make demo PHOTOS=folder   the same for your own photos
# make test                 lint, types and tests (with Blender 4.5, and 5.2 where Python 3.13 is there)
# make zip                  the Blender extension without its libraries in dist/
# make atlas                the public map's server on this computer, with the sample site in it (docs/atlas.md)
# make packages             self-contained zips and their extension repository in dist/repository (wheels/README.md)

PYTHON ?= python3
PHOTOS ?= samples/tulou/photos
QUALITY ?= standard
NAME = $(if $(filter samples/tulou/photos,$(PHOTOS)),tulou,$(shell basename "$(abspath $(PHOTOS))"))
OUT ?= demo/$(NAME)
# The first Python 3.13 that really starts: a version manager's placeholder does not.
PYTHON313 ?= $(shell for p in python3.13 $$HOME/.pyenv/versions/3.13*/bin/python; do "$$p" -c "" 2>/dev/null && echo "$$p" && break; done)
VENV = .venv/bin/python
export PYTHONPATH := $(CURDIR)

.PHONY: demo test zip packages environment atlas

environment: .venv/.ready

.venv/.ready: curecon_blender/requirements.txt requirements-dev.txt atlas/requirements.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info[:2] != (3, 11) and 'Python 3.11 is needed: make PYTHON=python3.11')"
	$(PYTHON) -m venv .venv
	$(VENV) -m pip install --quiet --disable-pip-version-check -r requirements-dev.txt
	touch $@

.venv-blender52/.ready: requirements-blender52.txt
	"$(PYTHON313)" -m venv .venv-blender52
	.venv-blender52/bin/python -m pip install --quiet --disable-pip-version-check -r requirements-blender52.txt
	touch $@

demo: .venv/.ready
	$(VENV) -m curecon_blender.core reconstruct "$(PHOTOS)" --workspace "$(OUT)/workspace" --quality $(QUALITY)
	$(VENV) scripts/demo_scene.py "$(OUT)/workspace" "$(OUT)/$(NAME).blend" "$(OUT)/$(NAME).png"

# SITE=folder puts that published folder in it instead of the sample site, which takes minutes to be made.
SITE ?= demo/published
atlas: .venv-atlas/.ready $(SITE)/index.html
	.venv-atlas/bin/python -m atlas demo demo/atlas/atlas.toml "$(SITE)"

.venv-atlas/.ready: atlas/requirements.txt
	$(PYTHON) -m venv .venv-atlas
	.venv-atlas/bin/python -m pip install --quiet --disable-pip-version-check -r atlas/requirements.txt
	touch $@

demo/published/index.html: .venv/.ready
	$(VENV) -m curecon_blender.core reconstruct samples/tulou/photos --workspace demo/tulou/workspace --quality preview
	$(VENV) -m curecon_blender.core publish demo/tulou/workspace demo/published --location cell --title "Yude Lou" \
		--place "Fujian, China"

test: .venv/.ready $(if $(PYTHON313),.venv-blender52/.ready)
	$(VENV) -m ruff check .
	$(VENV) -m mypy curecon_blender/core curecon_blender/job.py training evaluation survey atlas
	$(VENV) -m pytest -n 2 --dist worksteal --durations=10

zip: .venv/.ready
	$(VENV) scripts/build_extension.py

packages: .venv/.ready
	$(VENV) scripts/wheel_locks.py fetch
	$(VENV) scripts/build_extension.py --with-wheels

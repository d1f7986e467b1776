# The development tasks of J2A. `make help` lists them.
# Set-up is part of every task that needs it: system packages by apt-get (tools/system.sh), then
# .venv with the packages that constraints.txt pins (tools/venv.sh).

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test exhaustive lint conformance mutants trace docs bench demo-servo demo-robot picture page firmware flash venv constraints clean distclean

VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
# PYTHON= names the interpreter for a new .venv; all else runs with the one in .venv.
FIRMWARE := $(MAKE) --no-print-directory -C firmware PYTHON=../$(BIN)/python

help:  ## list the tasks
	@sed -n 's/^\([a-z][a-z-]*\):.*##  */\1\t/p' $(MAKEFILE_LIST) | expand -t 14

demo: $(INSTALLED)  ## a host program, firmware in the AVR simulator, a conformance run
	@sh tools/system.sh demo
	@$(BIN)/python tools/demo.py

demo-servo: $(INSTALLED)  ## an encoder turns a servo through the host, in the AVR simulator (chapter 9)
	@sh tools/system.sh demo
	@$(BIN)/python tools/demo_servo.py

demo-robot: $(INSTALLED)  ## two simulated boards in ROS 1, in ROS 2 and on a live page (needs rospy, chromium, npm)
	@sh tools/system.sh test
	@sh tools/page.sh
	@$(BIN)/python tools/demo_robot.py

picture: demo-robot  ## take the picture of the live page in README and docs anew
	@cp build/demo-robot.png docs/_static/view.png

test: $(INSTALLED)  ## all checks and all tests; CHECK=ruff,mypy runs only these steps
	@sh tools/system.sh test
	@bash tools/check.sh

exhaustive: $(INSTALLED)  ## what make test leaves out: soaks, every mutant, fuzzing, every guest; hours; CHECK= as there
	@sh tools/system.sh test
	@bash tools/exhaustive.sh

lint: $(INSTALLED)  ## lint, layout, types and import arrows
	@CHECK=ruff,format,mypy,mypy-tools,imports bash tools/check.sh

conformance: $(INSTALLED)  ## the suite against every testee, with reports in build/conformance
	@sh tools/system.sh test
	@$(BIN)/python tools/conformance.py

mutants: $(INSTALLED)  ## the mutants whose verdict may have changed, and renew conformance/mutants/judged.json
	@sh tools/system.sh demo
	@$(BIN)/python conformance/mutants/kill.py --changed --record

trace: conformance  ## renew conformance/trace.json, after make conformance
	@$(BIN)/python -m tools.trace

docs: $(INSTALLED)  ## the documentation, into docs/_build/html
	@$(BIN)/python -m sphinx -E -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

bench: $(INSTALLED)  ## speed as ratios: frames, calls, costs that must not grow, and samples
	@$(BIN)/python -m j2a.tests.benchmarks.ratios
	@$(BIN)/python -m j2a.tests.benchmarks.calls
	@$(BIN)/python -m j2a.tests.benchmarks.growth
	@$(BIN)/python -m j2a.tests.benchmarks.samples
	@sh tools/system.sh demo
	@$(BIN)/python tools/robot_load.py

page:  ## what the live page (j2a view) needs from npm, into the package; needs nodejs and npm
	@sh tools/page.sh

firmware: $(INSTALLED)  ## the demo firmware for posix and the AVR, and its size
	@sh tools/system.sh demo
	@$(FIRMWARE) PORT=posix APP=demo
	@$(FIRMWARE) PORT=avr-serial APP=demo

flash:  ## an app onto an AVR by avrdude: PORT=avr-serial DEVICE=/dev/ttyACM0, APP=demo
	@$(FIRMWARE) flash

venv: $(INSTALLED)  ## the virtual environment .venv; PYTHON= names the interpreter for it
	@echo "$(VENV) is ready"

$(INSTALLED): constraints.txt pyproject.toml tools/venv.sh
	@PYTHON='$(PYTHON)' sh tools/venv.sh $(VENV)
	@touch $@

constraints: $(INSTALLED)  ## pin the newest packages that pyproject.toml allows
	@$(BIN)/uv pip compile pyproject.toml --extra dev --no-emit-package j2a --universal \
	    --python-version 3.11 --fork-strategy fewest --generate-hashes --no-emit-index-url \
	    --no-annotate --no-header --upgrade --quiet --output-file constraints.txt

clean:  ## remove what was built
	@rm -rf build dist docs/_build firmware/build .coverage .coverage.* .benchmarks
	@rm -rf .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	@find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print0 | xargs -0 rm -rf

distclean: clean  ## also remove .venv
	@rm -rf $(VENV)

"""What methods are called in menus, titles and legends."""

import subprocess
import sys

from qdil import names


def test_methods_are_spelled_as_the_paper_spells_them():
    spelled = {
        "true": "Expert", "gail": "GAIL", "mconbo-gail": "MConbo-GAIL", "mcond-vail": "MCond-VAIL",
        "mbo-true": "Mbo-Expert", "maxent": "Max-Ent", "mconbo-gail-obs": "MConbo-GAIL from observation",
        "mbo-nearest": "Mbo-nearest", "mbo-diffail": "Mbo-DiffAIL",
    }  # fmt: skip
    assert {method: names.title(method) for method in spelled} == spelled


def test_naming_a_method_does_not_import_jax():
    code = "import sys, qdil.names; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0

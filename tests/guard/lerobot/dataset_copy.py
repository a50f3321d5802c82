"""Copies of LeRobot datasets whose meta/info.json a test changes."""

import json
import shutil


def copy_dataset(source, target, edit=None):
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target)
    if edit:
        file = target / "meta/info.json"
        info = json.loads(file.read_text())
        edit(info)
        file.write_text(json.dumps(info))
    return target

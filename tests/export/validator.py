"""The validator of the Khronos Group for GLB files."""

import json
import shutil
import subprocess

import pytest

VALIDATE = """
const validator = require('gltf-validator'), fs = require('fs');
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then(report => {
  console.log(JSON.stringify(report.issues));
});
"""


def validator_issues(path, tmp_path_factory):
    """Returns what the validator says about a file: the numbers of its errors, warnings, infos and hints, and each."""
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    folder = tmp_path_factory.getbasetemp() / "validator"
    if not folder.exists():
        folder.mkdir()
        install = ["npm", "install", "--silent", "--no-audit", "--no-fund", "gltf-validator@2.0.0-dev.3.10"]
        if subprocess.run(install, cwd=folder, capture_output=True, check=False).returncode:
            folder.rmdir()
            pytest.skip("the package gltf-validator cannot be installed")
    done = subprocess.run(["node", "-e", VALIDATE, f"{path}"], cwd=folder, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)

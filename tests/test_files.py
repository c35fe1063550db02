"""Files that are whole or not there at all."""

import csv
import hashlib
import json

import numpy as np
import pytest

from qdil.files import replace_file, sha256, write_csv, write_json, write_npz


def test_a_failed_write_leaves_the_old_file_whole(tmp_path):
    path = tmp_path / "file"
    replace_file(path, lambda file: file.write(b"old") and None)

    def half(file):
        file.write(b"new, but")
        file.flush()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        replace_file(path, half)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_new_name_appears_only_when_the_file_is_whole(tmp_path):
    path = tmp_path / "new folder" / "file"

    def write(file):
        file.write(b"whole")
        assert not path.exists()

    replace_file(path, write)
    assert path.read_bytes() == b"whole"
    assert path.stat().st_mode & 0o777 == 0o644


def test_equal_arrays_give_equal_bytes(tmp_path):
    arrays = {"a": np.arange(5.0), "b": np.ones((2, 3), bool)}
    for name in ("one", "two"):
        write_npz(tmp_path / name, **{key: value.copy() for key, value in arrays.items()})
    write_npz(tmp_path / "other", **(arrays | {"a": np.arange(5.0) + 1}))
    assert sha256(tmp_path / "one") == sha256(tmp_path / "two") != sha256(tmp_path / "other")
    assert sha256(tmp_path / "one") == hashlib.sha256((tmp_path / "one").read_bytes()).hexdigest()
    with np.load(tmp_path / "one", allow_pickle=False) as back:
        assert sorted(back.files) == ["a", "b"]
        np.testing.assert_array_equal(back["b"], arrays["b"])


def test_json_comes_back(tmp_path):
    content = {"b": [1, 2.5], "a": {"c": None}}
    write_json(tmp_path / "file.json", content)
    back = json.loads((tmp_path / "file.json").read_text())
    assert back == content and list(back) == ["b", "a"]


def test_csv_has_a_header_and_leaves_gaps_empty(tmp_path):
    write_csv(tmp_path / "file.csv", ["x", "y"], [{"x": 1, "y": "a,b"}, {"x": 2}])
    with open(tmp_path / "file.csv", newline="") as file:
        assert list(csv.reader(file)) == [["x", "y"], ["1", "a,b"], ["2", ""]]

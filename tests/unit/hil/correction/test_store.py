"""The sealed store of an axis: what is saved comes back, beside its neighbours, and a foreign one is known before measuring."""

from __future__ import annotations

import base64
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from support import bench_axis

from drivers.errors import InputError, StateError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.correction.sealed import ForeignSignatureError, TruncatedError, WrongPasswordError, check
from hil.correction.store import SealedStore
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.records.zero import Zero, write_zero

VERSION_1 = base64.b64decode(
    "SElMU0VBTAEAAAGMeyJidWlsZGVyIjoiMDNhMTA3YmZmM2NlMTBiZTFkNzBkZDE4ZTc0YmMwOTk2N2U0ZDYzMDliYTUwZDVmMWRkYzg2NjQxMj"
    "U1MzFiOCIsImNpcGhlciI6ImNoYWNoYTIwLXBvbHkxMzA1IiwiZW50cmllcyI6W3sibmFtZSI6IlgudGFibGVzIiwibm9uY2UiOiI0N2VmNTVh"
    "MjkwNDgwYTU5OWQzYzVjYjAiLCJzYWx0IjoiY2RkZDJkMzFlNDdkOGZmYmJjZjI5M2I3ZTMwYmJjMDgifSx7Im5hbWUiOiJYLmVmZmVjdHMiLC"
    "Jub25jZSI6ImQ5MGU1YzRkOWY5NmFlMDNhMjAzYWZmNSIsInNhbHQiOiJjZGRkMmQzMWU0N2Q4ZmZiYmNmMjkzYjdlMzBiYmMwOCJ9XSwiaWQi"
    "OiI4MmVmY2RmZDY2Y2YwNzdmM2E4ZTg1MjgzOWM1MmM3NCIsImtkZiI6eyJuIjoyLCJuYW1lIjoic2NyeXB0IiwicCI6MSwiciI6MX19gu/N/W"
    "bPB386joUoOcUsdAAAAAAA/7wrwpiCfazHymbjIZw38mVnQjAFbDYTmdGFg6qSsDEjNJPwiW6r+4dUWJsxMHOtA6PO4pNMUuXKrSVMxVoUJ9+U"
    "L+ILeONmAMhb49TeIV9DQB8AF4UG7CwLKFXSWjq3l+9BUWOKTsGD8JG3w1SGUEm5GPKGcvkZdil/6YjBztjgAaCHRhZ4ytRlmXy1ABjLsKEHqo"
    "IBw+IVhjUR42+CDwP260J9U0/8Gt8vYZT7pKd8to0u+hMFHSQ1XFPdsqugv9cT9x8pTvDD5uCTmwcp8WtqLvt8DfWGWz9+qaWF9+/SqdCapGBz"
    "G9CKhZchQm6/RudMACIx1GNuKET/HsTQEILvzf1mzwd/Oo6FKDnFLHQAAQAAABJg3T+LtmxIoZUOwTHmNqXG0ORWYfZSOiBCPkPAe4Wta/CwOl"
    "Dq+/R8SpthLzZq7WqkcU49rby+zV9LDuC8xnx9k1i191qmTm+y49YO+rMxbJsI"
)
"""A store of axis X from before sealed files stated a zero; its builder's key is bytes 0 to 31, its password "correct horse"."""
READING, KEY = bench_axis.PASSWORDS["HIL_PASSWORD"], bench_axis.PASSWORDS["HIL_KEY_PASSWORD"]


def tables(level_um: float) -> TableSet:
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable.constant(np.array([0.0, 100.0]), level_um))


@pytest.fixture
def axis(tmp_path: Path) -> AxisConfig:
    return load_axis(bench_axis.lay_out(tmp_path))


def test_several_axes_share_a_file_each_with_its_own_password(axis: AxisConfig) -> None:
    ours = SealedStore.of(axis, READING, KEY)
    theirs = SealedStore(ours.path, "Y", "another password", ours.builder_public, ours.builder_key)
    ours.save_tables(tables(1.0))
    theirs.save_tables(tables(2.0))
    ours.save_tables(tables(3.0))
    assert SealedStore.of(axis, READING).load().tables == tables(3.0)
    assert theirs.load().tables == tables(2.0)
    with pytest.raises(WrongPasswordError):
        SealedStore(ours.path, "Y", READING, ours.builder_public).load()
    with pytest.raises(InputError, match=r"tables\.sealed: sealed file holds no entry Z\.tables"):
        SealedStore(ours.path, "Z", READING, ours.builder_public).load()


def test_who_has_no_builder_key_cannot_write(axis: AxisConfig) -> None:
    SealedStore.of(axis, READING, KEY).save_tables(tables(1.0))
    with pytest.raises(StateError, match="builder's private key"):
        SealedStore.of(axis, READING).save_tables(tables(2.0))


def test_a_store_of_another_builder_is_refused_when_it_is_opened_for_writing(axis: AxisConfig, tmp_path: Path) -> None:
    SealedStore.of(axis, READING, KEY).save_tables(tables(1.0))
    other = load_axis(bench_axis.lay_out(tmp_path / "other"))
    other.tables_path.parent.mkdir()
    other.tables_path.write_bytes(axis.tables_path.read_bytes())
    with pytest.raises(ForeignSignatureError, match=r"tables\.sealed: .*signed with another key"):
        SealedStore.of(other, READING, KEY)
    other.tables_path.write_bytes(axis.tables_path.read_bytes()[:100])
    with pytest.raises(TruncatedError):
        SealedStore.of(other, READING, KEY)


def test_axes_that_save_at_the_same_moment_lose_nothing(axis: AxisConfig) -> None:
    ours = SealedStore.of(axis, READING, KEY)
    stores = [replace(ours, axis=name) for name in ("X", "Y", "Z")]
    with ThreadPoolExecutor(len(stores)) as pool:
        for level in (1.0, 2.0):
            list(pool.map(lambda store, level=level: store.save_tables(tables(level)), stores))
            assert [store.load().tables for store in stores] == [tables(level)] * len(stores)


# -- what it is bound to -----------------------------------------------------------------------------------------------------
ZERO = Zero("ab" * 16, "X", "2026-03-01T07:59:00+00:00", {"vendor": 1, "product": 2, "serial": 7}, True, 17, -5.0)


def test_tables_are_bound_to_the_zero_that_the_axis_has(axis: AxisConfig) -> None:
    store = SealedStore.of(axis, READING, KEY)
    store.save_tables(tables(1.0))
    assert store.load().zero is None
    warning = store.warning()
    assert warning is not None
    assert "states no zero of axis X" in warning
    write_zero(axis.zero_path, ZERO)
    store.save_tables(tables(1.0))
    assert store.load().zero == ZERO
    assert store.warning() is None
    binding = check(store.path.read_bytes(), store.builder_public).binding
    assert binding is not None
    assert binding.counter == 2
    assert binding.of["axes"]["X"]["zero"]["drive"] == {"vendor": 1, "product": 2, "serial": 7}


def test_what_other_axes_are_bound_to_is_kept(axis: AxisConfig) -> None:
    write_zero(axis.zero_path, ZERO)
    ours = SealedStore.of(axis, READING, KEY)
    ours.save_tables(tables(1.0))
    SealedStore(ours.path, "Y", "another password", ours.builder_public, ours.builder_key).save_tables(tables(2.0))
    assert ours.load().zero == ZERO
    assert SealedStore(ours.path, "Y", "another password", ours.builder_public).load().zero is None


def test_a_store_of_before_opens_with_a_warning_and_is_bound_when_it_is_written(tmp_path: Path) -> None:
    key = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
    path = tmp_path / "tables.sealed"
    path.write_bytes(VERSION_1)
    store = SealedStore(path, "X", "correct horse", key.public_key(), key, zero_path=tmp_path / "X.zero.json")
    before = store.load()
    assert before.tables.correction_um([100.0], 1)[0] == pytest.approx(1.0)
    assert before.zero is None
    warning = store.warning()
    assert warning is not None
    assert warning.startswith(f"{path}: states no zero")
    write_zero(tmp_path / "X.zero.json", ZERO)
    store.save(before)
    assert (store.load(), store.load().zero, store.warning()) == (before, ZERO, None)

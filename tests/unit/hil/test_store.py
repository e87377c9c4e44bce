"""The sealed store of an axis: what is saved comes back, beside its neighbours, and a foreign one is known before measuring."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis

from drivers.errors import InputError, StateError
from hil.axis import AxisConfig, load_axis
from hil.sealed import ForeignSignatureError, TruncatedError, WrongPasswordError
from hil.store import SealedStore
from hil.tables import DirectionalTable, TableMode, TableSet

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

"""The sealed store of an axis: what is saved comes back, beside its neighbours, and a foreign one is known before measuring."""

from __future__ import annotations

import base64
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from support import bench_axis

from drivers.errors import InputError, StateError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.correction.sealed import (
    ForeignSignatureError,
    TruncatedError,
    WrongPasswordError,
    check,
    load_private_key,
    open_sealed,
    seal,
)
from hil.correction.store import SealedStore, bound_tables
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet
from hil.records.made_with import MadeWith, write_made_with
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
    with pytest.raises(InputError, match=r"tables\.sealed: holds no tables of axis Z, only of"):
        SealedStore(ours.path, "Z", READING, ours.builder_public).load()


def test_the_tables_of_one_axis_are_taken_out_of_a_shared_file(axis: AxisConfig) -> None:
    ours = SealedStore.of(axis, READING, KEY, own={"backlash": "a backlash of its own"})
    theirs = SealedStore(ours.path, "Y", "another password", ours.builder_public, ours.builder_key)
    write_made_with(axis.made_with_path, MadeWith({"6092h:01": 10.0}))
    ours.save_tables(full_tables())
    theirs.save_tables(tables(2.0))
    with pytest.raises(StateError, match="builder's private key"):
        SealedStore.of(axis, READING).withdraw()
    withdrawing = SealedStore.of(axis, "", KEY)  # who lost the reading passwords may still take them out
    assert withdrawing.withdraw().made_with == MadeWith({"6092h:01": 10.0})
    assert (ours.stored(), ours.states(), bound_tables(axis)) == (None, None, None)
    assert theirs.stored() == theirs.load()
    info = check(ours.path.read_bytes(), ours.builder_public)
    assert list(info.entries) == ["Y.tables", "Y.effects"]
    assert info.binding is not None
    assert list(info.binding.of["axes"]) == ["Y"]
    with pytest.raises(StateError, match="holds no tables of axis X, nothing is in force"):
        ours.withdraw()
    plain = SealedStore.of(axis, READING, KEY)
    plain.save_tables(tables(3.0))
    assert (plain.load().tables, theirs.load().tables) == (tables(3.0), tables(2.0))
    theirs.withdraw()
    plain.withdraw()
    assert not plain.path.exists(), "no file is left without entries"
    plain.save_tables(tables(4.0))
    assert plain.load().tables == tables(4.0)


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


MADE_WITH = MadeWith({"6091h:01": 1.0}, {"2201h:00": 0.0})


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
    assert "does not state which parameters the drive of axis X had" in str(store.warning())
    write_made_with(axis.made_with_path, MADE_WITH)
    store.save_tables(tables(1.0))
    assert (store.load().made_with, store.warning()) == (MADE_WITH, None)
    binding = check(store.path.read_bytes(), store.builder_public).binding
    assert binding is not None
    assert binding.counter == 3
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
    write_made_with(tmp_path / "X.made-with.json", MADE_WITH)
    replace(store, made_with_path=tmp_path / "X.made-with.json").save(before)
    assert (store.load(), store.load().zero, store.warning()) == (before, ZERO, None)
    assert store.load().made_with == MADE_WITH


# -- passwords -------------------------------------------------------------------------------------------------------------------
OWN = {"backlash": "backlash by torque", "straightness": "granite of the shop"}


def full_tables() -> TableSet:
    at = np.array([0.0, 100.0])
    pitch = DirectionalTable(at, np.array([1.0, 2.0]), np.array([-3.0, -4.0]))
    amount, straight = (
        SingleTable(np.array([10.0, 50.0]), np.array([5.0, 7.0])),
        DirectionalTable.alike(at, [0.5, 0.25]),
    )
    return TableSet(TableMode.MEAN_BACKLASH, pitch, amount, None, straight)


def test_each_table_has_the_common_password_or_one_of_its_own(axis: AxisConfig) -> None:
    SealedStore.of(axis, READING, KEY, own=OWN).save_tables(full_tables())
    store = SealedStore.of(axis, READING, own=OWN)
    assert store.load().tables == full_tables()
    data, public = store.path.read_bytes(), store.builder_public
    assert set(check(data, public).entries) == {"X.tables", "X.effects", "X.backlash", "X.straightness"}
    for table, password in OWN.items():
        name = f"X.{table}"
        assert b"_um" in open_sealed(data, {name: password}, public)[name]
        with pytest.raises(WrongPasswordError):
            open_sealed(data, {name: READING}, public)
        with pytest.raises(InputError, match=f"table {table} of axis X has a password of its own"):
            SealedStore.of(axis, READING, own={other: OWN[other] for other in OWN if other != table}).load()
    apart = json.loads(open_sealed(data, READING, public, names=["X.tables"])["X.tables"])
    assert (apart["backlash"], apart["straightness"]) == (None, None)
    with pytest.raises(InputError, match="have format 'hil-tables/1, some apart'"):
        TableSet.from_dict(apart)  # who does not know of them does not take them for missing
    with pytest.raises(InputError, match=r"table backlash of axis X has a password of its own \(--table-password"):
        SealedStore.of(axis, READING, KEY)
    with pytest.raises(WrongPasswordError):
        SealedStore.of(axis, READING, own={**OWN, "backlash": "another password"}).load()
    with pytest.raises(InputError, match="given for table wear, expected one of pitch, backlash"):
        SealedStore.of(axis, READING, own={"wear": "some long password"})
    states = store.states()
    assert states is not None
    assert states.separate == ("backlash", "straightness")


@pytest.mark.parametrize("weak", ["fourteen chars", "aaaabbbbaaaabbbb", "x"])
def test_a_new_password_has_a_least_strength_and_one_that_exists_opens(axis: AxisConfig, weak: str) -> None:
    with pytest.raises(InputError, match=r"password of X\.tables is new and has \d+ characters, .*NIST SP 800-63B-4"):
        SealedStore.of(axis, weak, KEY)
    with pytest.raises(InputError, match=r"password of X\.backlash is new"):
        SealedStore.of(axis, READING, KEY, own={"backlash": weak})
    builder_key = load_private_key(axis.store.builder_key, KEY)
    entries = {"X.tables": json.dumps(full_tables().to_dict()).encode(), "X.effects": b"[]"}
    axis.tables_path.parent.mkdir()
    axis.tables_path.write_bytes(seal(entries, weak, builder_key))  # of an earlier version
    SealedStore.of(axis, weak, KEY).save_tables(tables(2.0))
    assert SealedStore.of(axis, weak).load().tables == tables(2.0)
    with pytest.raises(InputError, match="is new"):
        SealedStore.of(axis, "y" * 40, KEY)  # another one in its place
    with pytest.raises(InputError, match=r"password of Y\.tables is new"):
        replace(SealedStore.of(axis, weak, KEY), axis="Y").save_tables(tables(2.0))
    assert SealedStore.of(axis, weak).load().tables == tables(2.0)

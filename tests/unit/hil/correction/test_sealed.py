"""Sealed files: what opens, and every way of meddling that must not."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import shutil
import stat
import struct
import subprocess
import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, NoEncryption, PrivateFormat
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.files import replace_file
from hil.correction.sealed import (
    Cost,
    CostError,
    DamagedError,
    ForeignSignatureError,
    NotSealedError,
    SealedError,
    SwappedError,
    TruncatedError,
    UnknownVersionError,
    UnsignedError,
    WrongPasswordError,
    check,
    check_detached,
    fingerprint,
    is_sealed,
    load_private_key,
    load_public_key,
    new_key,
    open_sealed,
    require_strong,
    require_strong_new,
    reseal,
    resign,
    save_private_key,
    save_public_key,
    seal,
    sign_detached,
)
from hil.correction.sealed.container import unpack
from hil.correction.sealed.errors import WrongKeyPasswordError
from hil.correction.sealed.keys import KEY_COST
from hil.correction.sealed.seen import SeenFile
from hil.records import files

CHEAP = Cost(n=2, r=1, p=1)
DOMAIN = b"hil sealed file\0"
"""Begin of what the builder signs, as the documentation of the layout has it."""
BUILDER = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
STRANGER = Ed25519PrivateKey.from_private_bytes(bytes(range(1, 33)))
PUBLIC = BUILDER.public_key()
ENTRIES = {"pitch.json": b'{"section_mm": [0.0, 10.0]}', "backlash.json": b'{"amount_um": 4.5}', "empty": b""}
BOUND = {"axes": {"X": {"zero": "3f", "drive": {"serial": 7}}}}
SEALED = seal(ENTRIES, "correct horse", BUILDER, cost=CHEAP, bound_to=BOUND)

VERSION_1 = base64.b64decode(
    "SElMU0VBTAEAAAHweyJidWlsZGVyIjoiMDNhMTA3YmZmM2NlMTBiZTFkNzBkZDE4ZTc0YmMwOTk2N2U0ZDYzMDliYTUwZDVmMWRkYzg2NjQxMjU1MzFi"
    "OCIsImNpcGhlciI6ImNoYWNoYTIwLXBvbHkxMzA1IiwiZW50cmllcyI6W3sibmFtZSI6InBpdGNoLmpzb24iLCJub25jZSI6IjY4ZWE2NjU1MDViMjhm"
    "MDdlNGYyNmQ4MCIsInNhbHQiOiI4YzA5NDliZTBkZDZiYWEzMTU2NDg4NmZmZjZhMzdiNSJ9LHsibmFtZSI6ImJhY2tsYXNoLmpzb24iLCJub25jZSI6"
    "ImVkZjFjMDYzOGExM2QzMDVkZTY4Y2ZhZSIsInNhbHQiOiI4YzA5NDliZTBkZDZiYWEzMTU2NDg4NmZmZjZhMzdiNSJ9LHsibmFtZSI6ImVtcHR5Iiwi"
    "bm9uY2UiOiIyNjYwMjQzZjY2NzgxMmU0NmU2NWY3NDAiLCJzYWx0IjoiOGMwOTQ5YmUwZGQ2YmFhMzE1NjQ4ODZmZmY2YTM3YjUifV0sImlkIjoiMDRh"
    "YTIxZTIzNjkxNTJkMTFlYTY0ZmRiNWY0ZTg0NGQiLCJrZGYiOnsibiI6MiwibmFtZSI6InNjcnlwdCIsInAiOjEsInIiOjF9fQSqIeI2kVLRHqZP219O"
    "hE0AAAAAACt5f4YxAuJ3Ad04HHK0uH3sWbbw2nQkyTyC9r3ad9CQLJrfV8oMsrP3LxdZBKoh4jaRUtEepk/bX06ETQABAAAAIime04zPUSO/DiTA9EhD"
    "1wCtagdGVE5pIm6pIHInq7yAwTYEqiHiNpFS0R6mT9tfToRNAAIAAAAQDwFHmXEA1KN1tqY7Tvug8FcHwybGvgN4ghPiXhsc9k9oYqmA9132LB2qU7y2"
    "Wp7P4G1eVJxZC7fydW7X+UBU9pmlRV2gW7G3zqjul1sZ5wQ="
)
"""The same entries as they were sealed before files had a binding."""


def header_end(data: bytes) -> int:
    return 12 + int(struct.unpack(">I", data[8:12])[0])


def with_header(data: bytes, header: bytes, key: Ed25519PrivateKey | None = None) -> bytes:
    """`data` with another header; signed with `key`, else with the old signature left on."""
    body = data[:8] + struct.pack(">I", len(header)) + header + data[header_end(data) : -64]
    return body + (data[-64:] if key is None else key.sign(DOMAIN + body))


def chunks(data: bytes) -> list[bytes]:
    position, found = header_end(data), []
    while position < len(data) - 64:
        (length,) = struct.unpack(">I", data[position + 18 : position + 22])
        found.append(data[position : position + 22 + length])
        position += 22 + length
    return found


def flipped(data: bytes, position: int, bit: int) -> bytes:
    return data[:position] + bytes([data[position] ^ 1 << bit]) + data[position + 1 :]


# what works


@given(
    entries=st.dictionaries(
        st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,20}", fullmatch=True),
        st.binary(max_size=300),
        min_size=1,
        max_size=5,
    ),
    password=st.text(min_size=1, max_size=30).filter(lambda text: text.isprintable()),
)
@settings(max_examples=50)
def test_what_is_sealed_opens_again(entries: dict[str, bytes], password: str) -> None:
    data = seal(entries, password, BUILDER, cost=CHEAP)
    assert open_sealed(data, password, PUBLIC) == entries
    for content, chunk in zip(entries.values(), chunks(data), strict=True):
        assert len(content) < 6 or content not in chunk[22:]


def test_individual_passwords_open_their_own_entry_only() -> None:
    own = {"pitch.json": "one", "backlash.json": "two", "empty": "three"}
    data = seal(ENTRIES, own, BUILDER, cost=CHEAP)
    assert open_sealed(data, own, PUBLIC) == ENTRIES
    assert open_sealed(data, {"backlash.json": "two"}, PUBLIC) == {"backlash.json": ENTRIES["backlash.json"]}
    assert open_sealed(data, "one", PUBLIC, names=["pitch.json"]) == {"pitch.json": ENTRIES["pitch.json"]}
    with pytest.raises(WrongPasswordError, match=r"entry backlash\.json"):
        open_sealed(data, "one", PUBLIC)


def test_same_input_sealed_twice_shares_no_secret_material() -> None:
    again = seal(ENTRIES, "correct horse", BUILDER, cost=CHEAP)
    assert not {c[22:] for c in chunks(again)} & {c[22:] for c in chunks(SEALED)}


def test_a_password_is_the_same_however_its_accents_are_typed() -> None:
    data = seal({"a": b"x"}, "Ma\u00dfst\u00e4be", BUILDER, cost=CHEAP)
    assert open_sealed(data, "Ma\u00dfsta\u0308be", PUBLIC) == {"a": b"x"}


@pytest.mark.parametrize(("typed", "alike"), [("x\u00b2", "x2"), ("\ufb01n", "fin"), ("\u2460", "1"), ("\uff21", "A")])
def test_characters_that_only_look_alike_are_other_passwords(typed: str, alike: str) -> None:
    """Composed (NFC) and no further: compatibility (NFKC) would make the superscript a digit and the ligature two letters."""
    data = seal({"a": b"x"}, typed, BUILDER, cost=CHEAP)
    assert open_sealed(data, typed, PUBLIC) == {"a": b"x"}
    with pytest.raises(WrongPasswordError):
        open_sealed(data, alike, PUBLIC)


def by_hand(name: str, plain: bytes, password: str) -> bytes:
    """A sealed file with one entry, put together from the layout in the documentation: scrypt by OpenSSL, the rest by RFC."""
    salt, nonce, file_id = bytes(range(16)), bytes(range(12)), b"0123456789abcdef"
    entry = {"name": name, "nonce": nonce.hex(), "salt": salt.hex()}
    form = {"cipher": "chacha20-poly1305", "id": file_id.hex(), "kdf": {"n": 16, "name": "scrypt", "p": 3, "r": 2}}

    def canonical(value: object) -> bytes:
        return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()

    secret = hashlib.scrypt(password.encode(), salt=salt, n=16, r=2, p=3, dklen=32)
    beside = b"HILSEAL\x01" + canonical({**form, "entries": [0, entry]})
    ciphertext = ChaCha20Poly1305(secret).encrypt(nonce, plain, beside)
    header = canonical({**form, "builder": PUBLIC.public_bytes_raw().hex(), "entries": [entry]})
    body = b"HILSEAL\x01" + len(header).to_bytes(4, "big") + header
    body += file_id + b"\0\0" + len(ciphertext).to_bytes(4, "big") + ciphertext
    return body + BUILDER.sign(DOMAIN + body)


def test_a_file_put_together_by_hand_opens() -> None:
    """So a file that was written before opens after."""
    data = by_hand("pitch.json", b"3.5 um", "secret")
    assert open_sealed(data, "secret", PUBLIC) == {"pitch.json": b"3.5 um"}
    info = check(data, PUBLIC).as_json()
    assert info == {
        "id": b"0123456789abcdef".hex(),
        "version": 1,
        "builder": fingerprint(PUBLIC),
        "entries": {"pitch.json": 6},
        "kdf": "scrypt n=16 r=2 p=3",
        "cipher": "chacha20-poly1305",
        "sha256": hashlib.sha256(data).hexdigest(),
        "binding": None,
    }
    with pytest.raises(WrongPasswordError):
        open_sealed(data, "Secret", PUBLIC)
    assert is_sealed(data)
    assert not is_sealed(data[1:])


def test_the_fingerprint_is_half_a_sha256_in_groups() -> None:
    """FIPS 180: SHA-256 of "abc" begins ba7816bf 8f01cfea 414140de 5dae2223."""
    assert fingerprint(b"abc") == "ba78 16bf 8f01 cfea 4141 40de 5dae 2223"


def test_salts_are_shared_by_a_password_and_never_by_two() -> None:
    def salts(data: bytes) -> list[str]:
        return [entry["salt"] for entry in json.loads(data[12 : header_end(data)])["entries"]]

    assert len(set(salts(SEALED))) == 1
    own = seal({"a": b"", "b": b"", "c": b""}, {"a": "1", "b": "2", "c": "1"}, BUILDER, cost=CHEAP)
    assert salts(own)[0] == salts(own)[2] != salts(own)[1]


def test_check_shows_entries_and_cost_without_a_password() -> None:
    info = check(SEALED, PUBLIC)
    assert dict(info.entries) == {name: len(content) for name, content in ENTRIES.items()}
    assert info.kdf == "scrypt n=2 r=1 p=1"
    assert info.builder == fingerprint(PUBLIC)
    assert json.dumps(info.as_json())


def test_default_cost_is_memory_hard() -> None:
    cost = Cost()
    assert 128 * cost.n * cost.r >= 32 << 20
    assert cost.n * cost.r * cost.p >= 3 << 18
    assert (cost.n, cost.r, cost.p) == (32768, 8, 3)
    assert (KEY_COST.n, KEY_COST.r, KEY_COST.p) == (16384, 8, 5)
    code = "from hil.correction.sealed.sealing import DEFAULT_COST; print(DEFAULT_COST)"  # tests have a cheaper one in here
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == f"{cost}\n"


@pytest.mark.parametrize(
    ("n", "r", "p", "good"),
    [
        (2, 1, 1, True),
        (1, 1, 1, False),
        (3, 1, 1, False),
        (2, 0, 1, False),
        (2, 1, 0, False),
        (1 << 18, 8, 1, True),  # 128·n·r = 256 MiB
        (1 << 19, 8, 1, False),
        (1 << 18, 9, 1, False),
        (1 << 13, 256, 1, True),
        (1 << 13, 257, 1, False),
        (1 << 15, 8, 32, True),  # n·r·p = 2^23
        (1 << 15, 8, 33, False),
    ],
)
def test_which_costs_are_taken(n: int, r: int, p: int, good: bool) -> None:
    if good:
        assert Cost(n, r, p).n == n
    else:
        with pytest.raises(CostError):
            Cost(n, r, p)


def test_how_large_a_header_may_be_and_how_many_entries() -> None:
    def stated(size: int) -> bytes:
        return b"HILSEAL\x01" + size.to_bytes(4, "big")

    with pytest.raises(TruncatedError, match="in its header"):
        check(stated(1 << 20), PUBLIC)
    with pytest.raises(DamagedError, match="expected at most 1048576"):
        check(stated((1 << 20) + 1), PUBLIC)
    many = {f"e{i}": b"" for i in range(1000)}
    assert len(check(seal(many, "x", BUILDER, cost=CHEAP), PUBLIC).entries) == 1000
    with pytest.raises(InputError, match="at most 1000"):
        seal({**many, "one": b""}, "x", BUILDER, cost=CHEAP)
    with pytest.raises(InputError, match="at most 1000"):
        reseal(seal(many, "x", BUILDER, cost=CHEAP), {"one": b""}, "x", BUILDER)
    longest = "x" * 100
    assert open_sealed(seal({longest: b""}, "p", BUILDER, cost=CHEAP), "p", PUBLIC) == {longest: b""}


# the header's binding


def test_a_file_says_what_it_is_bound_to_without_a_password() -> None:
    binding = check(SEALED, PUBLIC).binding
    assert binding is not None
    assert (binding.counter, binding.of) == (1, BOUND)
    assert datetime.fromisoformat(binding.date).tzinfo is not None


def test_the_counter_rises_with_each_reseal_and_the_binding_stays_unless_told() -> None:
    once = reseal(SEALED, {"more": b"1"}, "correct horse", BUILDER)
    twice = reseal(once, {"more": b"2"}, "correct horse", BUILDER, bound_to={"axes": {}})
    found = [check(data, PUBLIC).binding for data in (once, twice, resign(twice, PUBLIC, BUILDER))]
    assert [each and (each.counter, each.of) for each in found] == [(2, BOUND), (3, {"axes": {}}), (3, {"axes": {}})]


def test_a_binding_is_bounded_and_plain() -> None:
    with pytest.raises(InputError, match="expected at most 32768"):
        seal(ENTRIES, "x", BUILDER, cost=CHEAP, bound_to={"long": "x" * 40_000})
    for value in (float("nan"), {1, 2}):
        with pytest.raises(InputError, match="no JSON"):
            seal(ENTRIES, "x", BUILDER, cost=CHEAP, bound_to={"value": value})


def test_the_largest_binding_is_sealed_and_opens() -> None:
    """32 KiB of JSON."""
    beside = len('{"counter":1,"date":"2026-01-01T00:00:00+00:00","of":{"long":""}}')
    largest = {"long": "x" * (32_768 - beside)}
    binding = check(seal(ENTRIES, "x", BUILDER, cost=CHEAP, bound_to=largest), PUBLIC).binding
    assert binding is not None
    assert binding.of == largest
    with pytest.raises(InputError, match="has 32769 bytes"):
        seal(ENTRIES, "x", BUILDER, cost=CHEAP, bound_to={"long": largest["long"] + "x"})


def test_a_binding_is_written_sorted_and_in_ascii() -> None:
    """One spelling, whatever order the names came in: "ä" is U+00E4."""
    data = seal(ENTRIES, "x", BUILDER, cost=CHEAP, bound_to={"b": "ä", "a": 2})
    assert b'"of":{"a":2,"b":"\\u00e4"}' in data[: header_end(data)]
    binding = check(data, PUBLIC).binding
    assert binding is not None
    assert binding.of == {"a": 2, "b": "ä"}


@pytest.mark.parametrize(
    "binding",
    [
        "7",
        "null",
        '{"counter":0,"date":"","of":{}}',
        '{"counter":1.0,"date":"","of":{}}',
        '{"counter":1,"date":"","of":[]}',
    ],
)
def test_a_signed_header_with_a_wrong_binding_is_refused(binding: str) -> None:
    header = json.loads(SEALED[12 : header_end(SEALED)])
    header["binding"] = json.loads(binding)
    text = json.dumps(header, sort_keys=True, separators=(",", ":")).encode()
    with pytest.raises(DamagedError):
        check(with_header(SEALED, text, BUILDER), PUBLIC)


def test_a_file_of_version_1_opens_and_states_no_binding() -> None:
    assert open_sealed(VERSION_1, "correct horse", PUBLIC) == ENTRIES
    info = check(VERSION_1, PUBLIC)
    assert (info.version, info.binding) == (1, None)
    assert SeenFile.of(info).counter == 0  # so that the first change of it, number 1, is a later one


def test_a_file_of_version_1_is_bound_when_it_is_resealed() -> None:
    """The entries whose passwords are not at hand are kept as they are, and open afterwards."""
    bound = reseal(VERSION_1, {"empty": b"full"}, {"empty": "other"}, BUILDER, bound_to=BOUND)
    info = check(bound, PUBLIC)
    assert info.version == 2
    assert info.binding is not None
    assert (info.binding.counter, info.binding.of) == (1, BOUND)
    passwords = dict.fromkeys(ENTRIES, "correct horse") | {"empty": "other"}
    assert open_sealed(bound, passwords, PUBLIC) == {**ENTRIES, "empty": b"full"}


def test_a_binding_is_not_taken_off_by_calling_the_file_version_1() -> None:
    form = json.loads(SEALED[12 : header_end(SEALED)])
    text = json.dumps(form, sort_keys=True, separators=(",", ":")).encode()
    body = SEALED[:7] + b"\x01" + SEALED[8:12] + text + SEALED[header_end(SEALED) : -64]
    with pytest.raises(DamagedError):
        check(body + BUILDER.sign(DOMAIN + body), PUBLIC)


# every byte


@pytest.mark.parametrize("data", [SEALED, VERSION_1], ids=["version 2", "version 1"])
def test_every_flipped_bit_is_refused(data: bytes) -> None:
    for position in range(len(data)):
        for bit in range(8):
            with pytest.raises(SealedError):
                open_sealed(flipped(data, position, bit), "correct horse", PUBLIC)


def test_every_shorter_file_is_refused_as_truncated() -> None:
    for size in range(1, len(SEALED)):
        expected = UnsignedError if size == len(SEALED) - 64 else TruncatedError
        with pytest.raises(expected):
            check(SEALED[:size], PUBLIC)
    with pytest.raises(NotSealedError):
        check(b"", PUBLIC)


@given(data=st.binary(max_size=400))
@settings(max_examples=60)
def test_arbitrary_bytes_are_refused_cleanly(data: bytes) -> None:
    for form in (data, b"HILSEAL\x01" + data, SEALED[:60] + data, SEALED + data + b"."):
        with pytest.raises(SealedError):
            check(form, PUBLIC)


@given(
    header=st.recursive(
        st.none() | st.integers() | st.text(max_size=5),
        lambda x: st.lists(x) | st.dictionaries(st.sampled_from(["builder", "cipher", "entries", "id", "kdf", "n"]), x),
        max_leaves=8,
    )
)
@settings(max_examples=40)
def test_a_strange_header_is_damage_even_if_signed(header: object) -> None:
    with pytest.raises(DamagedError):
        check(with_header(SEALED, json.dumps(header).encode(), BUILDER), PUBLIC)


@pytest.mark.parametrize("header", [b"[" * 200_000, b"\xff\xfe", b"", b"{}", b"NaN"])
def test_a_header_that_is_no_header(header: bytes) -> None:
    with pytest.raises(DamagedError):
        check(with_header(SEALED, header, BUILDER), PUBLIC)


# each kind of meddling by its own name


def test_wrong_password() -> None:
    with pytest.raises(WrongPasswordError, match=r"wrong password for entry pitch\.json"):
        open_sealed(SEALED, "wrong horse", PUBLIC)


def test_a_flipped_bit_in_the_contents_is_damage_not_a_wrong_password() -> None:
    with pytest.raises(DamagedError, match="changed after the builder signed it"):
        open_sealed(flipped(SEALED, header_end(SEALED) + 30, 0), "correct horse", PUBLIC)


def test_header_of_another_valid_file() -> None:
    other = seal(ENTRIES, "correct horse", BUILDER, cost=CHEAP)
    with pytest.raises(SwappedError, match="belong to another sealed file"):
        check(with_header(SEALED, other[12 : header_end(other)]), PUBLIC)
    # and the cipher refuses it too, should the signature have been made anew
    with pytest.raises(SealedError):
        open_sealed(with_header(SEALED, other[12 : header_end(other)], BUILDER), "correct horse", PUBLIC)


def test_header_of_another_file_is_refused_by_the_cipher_alone() -> None:
    """The header is authenticated: same key, same nonce, same contents, one other header field, and a good signature."""
    header = json.loads(SEALED[12 : header_end(SEALED)])
    for change in ({"name": "other.json"}, {"nonce": "00" * 12}):
        changed = {**header, "entries": [{**header["entries"][0], **change}, *header["entries"][1:]]}
        text = json.dumps(changed, sort_keys=True, separators=(",", ":")).encode()
        data = with_header(SEALED, text, BUILDER)
        check(data, PUBLIC)
        with pytest.raises(WrongPasswordError):
            open_sealed(data, "correct horse", PUBLIC, names=[changed["entries"][0]["name"]])


def test_swapped_entries() -> None:
    first, second, third = chunks(SEALED)
    front = SEALED[: header_end(SEALED)]
    with pytest.raises(SwappedError, match="those of entry number 1, expected 0"):
        check(front + second + first + third + SEALED[-64:], PUBLIC)
    # renumbered, so that only the signature tells
    forged = front + first[:16] + b"\0\0" + second[18:] + first[:16] + b"\0\1" + first[18:] + third
    with pytest.raises(DamagedError):
        check(forged + SEALED[-64:], PUBLIC)
    # renumbered and signed by the builder: the cipher tells
    with pytest.raises(WrongPasswordError):
        open_sealed(forged + BUILDER.sign(DOMAIN + forged), "correct horse", PUBLIC)


def test_foreign_signature() -> None:
    foreign = seal(ENTRIES, "correct horse", STRANGER, cost=CHEAP)
    with pytest.raises(ForeignSignatureError, match=fingerprint(STRANGER.public_key())):
        check(foreign, PUBLIC)
    # a stranger's file that was changed after that is damage: nobody signed it
    with pytest.raises(DamagedError, match="or not signed by this builder"):
        check(flipped(foreign, -70, 1), PUBLIC)
    # a stranger's signature under the builder's header is not even that
    body = SEALED[:-64]
    with pytest.raises(DamagedError):
        check(body + STRANGER.sign(DOMAIN + body), PUBLIC)


def test_unknown_version_and_other_files() -> None:
    with pytest.raises(UnknownVersionError, match="version 3, expected 1 or 2"):
        check(SEALED[:7] + b"\x03" + SEALED[8:], PUBLIC)
    with pytest.raises(NotSealedError):
        check(b"run,direction,target_mm,measured_mm\n", PUBLIC)


def test_bytes_behind_the_end() -> None:
    with pytest.raises(DamagedError, match="3 bytes behind its end"):
        check(SEALED + b"abc", PUBLIC)
    with pytest.raises(DamagedError, match="1 bytes behind its end"):
        check(SEALED + b"\0", PUBLIC)
    with pytest.raises(TruncatedError, match="in its signature"):
        check(SEALED[:-1], PUBLIC)


def test_where_a_short_file_ends() -> None:
    end = header_end(SEALED)
    first = end + 22 + len(ENTRIES["pitch.json"]) + 16
    for size, where in (
        (11, "in its first line"),
        (12, "in its header"),
        (end - 1, "in its header"),
        (end, "before entry pitch.json"),
        (end + 21, "before entry pitch.json"),
        (end + 22, "in entry pitch.json"),
        (first - 1, "in entry pitch.json"),
        (first, "before entry backlash.json"),
    ):
        with pytest.raises(TruncatedError, match=f"ends after {size} bytes, {where}"):
            check(SEALED[:size], PUBLIC)


def test_a_header_with_an_entry_twice_or_none_is_damage_even_if_signed() -> None:
    header = json.loads(SEALED[12 : header_end(SEALED)])
    entries = header["entries"]
    for changed in (
        {"entries": []},
        {"entries": [entries[0], entries[0], entries[2]]},
        {"entries": [{**entries[0], "name": "../up"}, *entries[1:]]},
        {"entries": [{**entries[0], "salt": "00" * 15}, *entries[1:]]},
        {"entries": [{**entries[0], "nonce": "00" * 13}, *entries[1:]]},
        {"builder": "00" * 31},
        {"id": "00" * 17},
        {"id": None},
        {"cipher": "aes"},
        {"kdf": {**header["kdf"], "name": "pbkdf2"}},
        {"more": 1},
    ):
        text = json.dumps({**header, **changed}, sort_keys=True, separators=(",", ":")).encode()
        with pytest.raises(DamagedError, match="header"):
            check(with_header(SEALED, text, BUILDER), PUBLIC)
    with pytest.raises(DamagedError, match="canonical"):
        check(with_header(SEALED, json.dumps(header, sort_keys=True).encode(), BUILDER), PUBLIC)


@pytest.mark.parametrize(
    "kdf",
    [
        {"n": 1 << 40, "r": 8, "p": 1},
        {"n": 1 << 15, "r": 1 << 20, "p": 1},
        {"n": 1 << 15, "r": 8, "p": 1 << 30},
        {"n": 12345, "r": 8, "p": 1},
        {"n": 0, "r": 8, "p": 1},
        {"n": -4, "r": 8, "p": 1},
        {"n": 1 << 15, "r": 0, "p": 1},
    ],
)
def test_absurd_cost_is_refused_before_anything_is_computed(kdf: dict[str, int]) -> None:
    header = json.loads(SEALED[12 : header_end(SEALED)])
    header["kdf"] |= kdf
    text = json.dumps(header, sort_keys=True, separators=(",", ":")).encode()
    with pytest.raises(CostError):
        open_sealed(with_header(SEALED, text, BUILDER), "correct horse", PUBLIC)
    with pytest.raises(CostError):
        Cost(**kdf)


@pytest.mark.parametrize("value", [True, 8.0, "8", None])
def test_a_cost_that_is_no_whole_number_is_damage(value: object) -> None:
    header = json.loads(SEALED[12 : header_end(SEALED)])
    header["kdf"]["r"] = value
    with pytest.raises(DamagedError):
        check(with_header(SEALED, json.dumps(header, sort_keys=True, separators=(",", ":")).encode(), BUILDER), PUBLIC)


# bad calls


@pytest.mark.parametrize("name", ["", ".hidden", "../up", "a/b", "a b", "ü", "x" * 101])
def test_names_that_are_no_plain_file_names_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="entry name"):
        seal({name: b""}, "p", BUILDER, cost=CHEAP)


def test_missing_and_surplus_passwords_are_refused() -> None:
    with pytest.raises(InputError, match="no password is given for entry empty"):
        seal(ENTRIES, {"pitch.json": "a", "backlash.json": "b"}, BUILDER, cost=CHEAP)
    with pytest.raises(InputError, match="not among those"):
        seal({"a": b""}, {"a": "x", "b": "y"}, BUILDER, cost=CHEAP)
    with pytest.raises(InputError, match="password is empty"):
        seal({"a": b""}, "", BUILDER, cost=CHEAP)
    with pytest.raises(InputError, match="at least one entry"):
        seal({}, "x", BUILDER, cost=CHEAP)
    with pytest.raises(InputError, match="holds no entry nowhere"):
        open_sealed(SEALED, "correct horse", PUBLIC, names=["nowhere"])


# changing


def test_what_is_taken_out_leaves_its_place_to_the_next_entry() -> None:
    """The others open with their own passwords, of which none is given here."""
    own = {"a": "one", "b": "two", "c": "three", "d": "four"}
    data = seal({name: name.encode() for name in own}, own, BUILDER, cost=CHEAP)
    without = reseal(data, {}, {}, BUILDER, without=["b", "d"])
    assert list(check(without, PUBLIC).entries) == ["a", "c"]
    assert open_sealed(without, {"a": "one", "c": "three"}, PUBLIC) == {"a": b"a", "c": b"c"}
    assert unpack(data).ciphertexts[1] not in without
    with pytest.raises(InputError, match="holds no entry b, only a, c"):
        open_sealed(without, "two", PUBLIC, names=["b"])
    again = reseal(without, {"e": b"e", "f": b"f"}, "five", BUILDER)
    assert [entry.name for entry in unpack(again).header.entries] == ["a", "e", "c", "f"]
    assert open_sealed(again, {**own, "e": "five", "f": "five"}, PUBLIC, names=["a", "e", "c", "f"])["c"] == b"c"
    with pytest.raises(InputError, match="nothing to seal"):
        reseal(without, {}, {}, BUILDER, without=["a", "c"])
    with pytest.raises(InputError, match="cannot be used"):
        reseal(without, {"_vacant_1": b""}, "five", BUILDER)


def test_reseal_needs_only_the_changed_entrys_password() -> None:
    own = {"pitch.json": "one", "backlash.json": "two", "empty": "three"}
    data = seal(ENTRIES, own, BUILDER, cost=CHEAP)
    changed = reseal(data, {"backlash.json": b"new", "added": b"more"}, {"backlash.json": "2", "added": "4"}, BUILDER)
    assert open_sealed(changed, {**own, "backlash.json": "2", "added": "4"}, PUBLIC) == {
        **ENTRIES,
        "backlash.json": b"new",
        "added": b"more",
    }
    with pytest.raises(WrongPasswordError):
        open_sealed(changed, {"backlash.json": "two"}, PUBLIC)


def test_only_the_builder_reseals_and_only_good_files() -> None:
    with pytest.raises(ForeignSignatureError):
        reseal(SEALED, {"a": b""}, "x", STRANGER)
    with pytest.raises(DamagedError):
        reseal(flipped(SEALED, -70, 1), {"a": b""}, "x", BUILDER)


def test_resign_hands_on_a_good_file_without_passwords() -> None:
    handed = resign(SEALED, PUBLIC, STRANGER)
    assert open_sealed(handed, "correct horse", STRANGER.public_key()) == ENTRIES
    with pytest.raises(ForeignSignatureError):
        check(handed, PUBLIC)
    assert resign(SEALED, PUBLIC, BUILDER) == SEALED
    with pytest.raises(DamagedError):
        resign(flipped(SEALED, header_end(SEALED) + 25, 3), PUBLIC, STRANGER)
    with pytest.raises(ForeignSignatureError):
        resign(SEALED, STRANGER.public_key(), STRANGER)
    with pytest.raises(UnsignedError):
        resign(SEALED[:-64], PUBLIC, BUILDER)


# detached signatures


def test_detached_signatures() -> None:
    data = b"run,direction\n" * 3
    signature = sign_detached(data, BUILDER)
    check_detached(data, signature, PUBLIC)
    value = BUILDER.sign(b"hil detached signature, version 1\0" + data).hex()
    builder = PUBLIC.public_bytes_raw().hex()
    text = f'{{\n  "format": "hil-signature-1",\n  "builder": "{builder}",\n  "signature": "{value}"\n}}\n'
    assert signature.decode() == text  # as files have it that were signed before
    for position in range(len(data)):
        with pytest.raises(DamagedError):
            check_detached(flipped(data, position, position % 8), signature, PUBLIC)
    with pytest.raises(ForeignSignatureError):
        check_detached(data, sign_detached(data, STRANGER), PUBLIC)
    form = json.loads(signature)
    with pytest.raises(DamagedError, match="public key in it was changed"):
        check_detached(data, json.dumps({**form, "builder": "00" * 32}).encode(), PUBLIC)
    for bad in (b"", b"[]", b"{}", signature[:-20], json.dumps({**form, "signature": "00"}).encode(), b"[" * 100_000):
        with pytest.raises(InputError, match="not a detached signature"):
            check_detached(data, bad, PUBLIC)


def test_a_sealed_files_signature_is_no_detached_signature() -> None:
    form = {"format": "hil-signature-1", "builder": PUBLIC.public_bytes_raw().hex(), "signature": SEALED[-64:].hex()}
    with pytest.raises(DamagedError):
        check_detached(SEALED[:-64], json.dumps(form).encode(), PUBLIC)


# keys on disk


def test_key_files(tmp_path: Path) -> None:
    key = new_key()
    save_private_key(tmp_path / "b.key", key, "pässword of mine", cost=CHEAP)
    save_public_key(tmp_path / "b.pub", key.public_key())
    assert stat.S_IMODE((tmp_path / "b.key").stat().st_mode) == 0o600
    assert load_private_key(tmp_path / "b.key", "pässword of mine").private_bytes_raw() == key.private_bytes_raw()
    assert load_public_key(tmp_path / "b.pub").public_bytes_raw() == key.public_key().public_bytes_raw()
    with pytest.raises(WrongPasswordError):
        load_private_key(tmp_path / "b.key", "password of mine")
    for save in (lambda p: save_private_key(p, key, "builder of mine"), lambda p: save_public_key(p, key.public_key())):
        with pytest.raises(InputError, match="never overwritten"):
            save(tmp_path / "b.key")


@pytest.mark.parametrize(
    ("password", "strong"),
    [
        ("abcdeabcdeabcde", True),  # 15 characters, 5 of them different
        ("abcdeabcdeabcd", False),
        ("abcdabcdabcdabc", False),
        ("bcdefbcdefbcdf\u00e4", True),
        ("bcdefbcdefbcda\u0308", False),  # two code points, one character: 14 in all
        ("bcdefbcdefbcd\ufb01", False),  # a ligature is one: 14 in all, 15 letters
    ],
)
def test_how_long_a_new_password_has_to_be(password: str, strong: bool) -> None:
    """NIST SP 800-63B-4, 3.1.1.2: 15 characters at least, each code point one; five different ones are this program's own."""
    if strong:
        require_strong(password, "password")
    else:
        with pytest.raises(InputError, match="expected at least 15, 5 of them different"):
            require_strong(password, "password")


def test_only_a_new_password_has_to_be_strong() -> None:
    """One that opens its entry in the file there is may be as weak as it is; of another entry it is new."""
    there = seal({"a": b"1", "b": b"2"}, {"a": "weak", "b": "other"}, BUILDER, cost=CHEAP)
    require_strong_new({"a": "weak", "b": "other", "c": "a strong new password"}, there, PUBLIC)
    require_strong_new({"a": "a strong new password"}, None, PUBLIC)
    for passwords, present in (({"a": "weak"}, None), ({"b": "weak"}, there), ({"c": "weak"}, there)):
        with pytest.raises(InputError, match=f"password of {next(iter(passwords))} is new"):
            require_strong_new(passwords, present, PUBLIC)


def test_a_file_has_the_cost_that_was_asked_for() -> None:
    assert check(seal({"a": b""}, "x", BUILDER, cost=Cost(4, 3, 2)), PUBLIC).kdf == "scrypt n=4 r=3 p=2"


def _tagged(tag: int, body: bytes) -> bytes:
    assert len(body) < 256
    return bytes([tag]) + (bytes([len(body)]) if len(body) < 128 else bytes([0x81, len(body)])) + body


def _integer(value: int) -> bytes:
    return _tagged(2, value.to_bytes(value.bit_length() // 8 + 1, "big"))


def _asks_for(derivation: bytes) -> bytes:
    """An encrypted private key in DER whose scheme, PBES2, has this key derivation (RFC 8018, A.4)."""
    pbes2, cipher = bytes.fromhex("06092a864886f70d01050d"), bytes.fromhex("060960864801650304012a")
    scheme = _tagged(48, derivation + _tagged(48, cipher + _tagged(4, b"v" * 16)))
    return _tagged(48, _tagged(48, pbes2 + scheme) + _tagged(4, b"c" * 64))


@pytest.fixture
def take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[bytes], None]:
    """Loads a key file with this DER, whose key derivation is not computed: WrongKeyPasswordError where it is accepted."""

    def computes(*_: object) -> None:
        raise ValueError("not computed in a test")

    def load(der: bytes) -> None:
        text = base64.encodebytes(der).decode()
        (tmp_path / "k").write_text(
            f"-----BEGIN ENCRYPTED PRIVATE KEY-----\n{text}-----END ENCRYPTED PRIVATE KEY-----\n"
        )
        load_private_key(tmp_path / "k", "x")

    monkeypatch.setattr("hil.correction.sealed.keys.load_der_private_key", computes)
    return load


@pytest.mark.parametrize(("rounds", "good"), [(0, False), (1, True), (4_194_304, True), (4_194_305, False)])
def test_how_many_rounds_a_key_may_ask_for(rounds: int, good: bool, take: Callable[[bytes], None]) -> None:
    """As the page on security has it, 2²² at most. The identifier is PBKDF2's (RFC 8018, A.2)."""
    values = _tagged(48, _tagged(4, b"s" * 16) + _integer(rounds))
    asked = _asks_for(_tagged(48, bytes.fromhex("06092a864886f70d01050c") + values))
    with pytest.raises(WrongKeyPasswordError) if good else pytest.raises(CostError, match="1 to 4194304"):
        take(asked)


@pytest.mark.parametrize(
    ("cost", "good"), [((2**18, 8, 1), True), ((2**18, 9, 1), False), ((2**15, 8, 33), False), ((2**15, 8, 32), True)]
)
def test_how_much_scrypt_a_key_may_ask_for(
    cost: tuple[int, int, int], good: bool, take: Callable[[bytes], None]
) -> None:
    """256 MiB, and n·r·p of 2²³. Identifier and order of the values by RFC 7914, 7.1."""
    for key_length in (b"", _integer(32)):  # it may follow
        values = _tagged(48, _tagged(4, b"s" * 16) + b"".join(map(_integer, cost)) + key_length)
        asked = _asks_for(_tagged(48, bytes.fromhex("06092b06010401da47040b") + values))
        with pytest.raises(WrongKeyPasswordError if good else CostError):
            take(asked)


def test_a_new_key_from_a_script_has_a_password_of_the_least_strength(tmp_path: Path) -> None:
    for weak in ("builder", "aaaaaaaaaaaaaaaaaaaa"):
        with pytest.raises(
            InputError, match=r"password of the new key is new and has .* expected at least 15, 5 of them"
        ):
            save_private_key(tmp_path / "b.key", new_key(), weak, cost=CHEAP)
    assert not (tmp_path / "b.key").exists()


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl command to read the key with")
def test_the_private_key_file_is_pkcs8_that_a_foreign_tool_reads(tmp_path: Path) -> None:
    key = new_key()
    save_private_key(tmp_path / "b.key", key, "secret of the builder")
    command = [
        "openssl",
        "pkey",
        "-in",
        str(tmp_path / "b.key"),
        "-passin",
        "pass:secret of the builder",
        "-outform",
        "DER",
    ]
    der = subprocess.run(command, check=True, capture_output=True).stdout
    assert der[-32:] == key.private_bytes_raw()


OLD_KEY = """\
-----BEGIN ENCRYPTED PRIVATE KEY-----
MIGbMFcGCSqGSIb3DQEFDTBKMCkGCSsGAQQB2kcECzAcBBAzCAAAyrS63oOQk3aY
sKdQAgJAAAIBCAIBBTAdBglghkgBZQMEASoEENFi+MrXy/iymxP0qAuc2ZUEQFv1
QXMZkoU51wHCzKGWPJNGrZNmiUO8tA91ZFlQsDIN8keLHM6nwJVNZkQAiyb5lJBA
UUhMEKZvEg20Qtg+coU=
-----END ENCRYPTED PRIVATE KEY-----
"""


def test_keys_of_earlier_versions_and_of_other_tools_open(tmp_path: Path) -> None:
    """The first was written by this program's own DER writer, the second by the library: PBKDF2 with 2048 rounds."""
    path = tmp_path / "k"
    path.write_text(OLD_KEY)
    assert load_private_key(path, "an old secret of the builder").private_bytes_raw() == bytes(range(32))
    path.write_bytes(BUILDER.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"x")))
    assert load_private_key(path, "x").private_bytes_raw() == BUILDER.private_bytes_raw()


def test_what_is_no_builders_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "k"
    elliptic = ec.generate_private_key(ec.SECP256R1())
    cases = {
        "not a password-protected": [
            b"hello",
            BUILDER.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
        ],
        "of another kind": [elliptic.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"x"))],
    }
    for says, contents in cases.items():
        for content in contents:
            path.write_bytes(content)
            with pytest.raises(InputError, match=says):
                load_private_key(path, "x")
    path.write_bytes(b"hello")
    with pytest.raises(InputError, match="not a public key"):
        load_public_key(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_public_key(tmp_path / "absent")


# the disk


def test_replacing_keeps_permissions_and_leaves_no_litter(tmp_path: Path) -> None:
    path = tmp_path / "axis.sealed"
    replace_file(path, seal(ENTRIES, "pw", BUILDER, cost=CHEAP))
    path.chmod(0o640)
    (tmp_path / "link").symlink_to(path)
    replace_file(tmp_path / "link", seal({"a": b"1"}, "pw", BUILDER, cost=CHEAP))
    assert open_sealed(path.read_bytes(), "pw", PUBLIC) == {"a": b"1"}
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert sorted(p.name for p in tmp_path.iterdir()) == ["axis.sealed", "link"]


@pytest.mark.parametrize("fails", ["fsync", "replace", "fchmod"])
def test_a_failure_while_replacing_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    path = tmp_path / "axis.sealed"
    replace_file(path, seal(ENTRIES, "pw", BUILDER, cost=CHEAP))
    before = path.read_bytes()

    def broken(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, fails, broken)
    with pytest.raises(InputError, match=r"axis\.sealed: cannot be written: No space left"):
        replace_file(path, seal({"a": b"1"}, "pw", BUILDER, cost=CHEAP))
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["axis.sealed"]


def test_the_order_of_replacing_is_flush_rename_flush(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []
    fsync, replace = os.fsync, os.replace

    def spy_fsync(handle: int) -> None:
        steps.append("flush directory" if stat.S_ISDIR(os.fstat(handle).st_mode) else "flush file")
        fsync(handle)

    def spy_replace(source: str, target: str) -> None:
        steps.append("rename")
        assert Path(source).parent == Path(target).parent
        replace(source, target)

    monkeypatch.setattr(files.os, "fsync", spy_fsync)
    monkeypatch.setattr(files.os, "replace", spy_replace)
    replace_file(tmp_path / "x", b"1")
    assert steps == ["flush file", "rename", "flush directory"]

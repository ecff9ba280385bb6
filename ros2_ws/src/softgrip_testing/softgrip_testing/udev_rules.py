# SPDX-License-Identifier: Apache-2.0
"""A strict reader of udev rules, and what they do to a device: for rules that no udev here can be asked about.

Keys and operators are those of udev(7) of systemd 252. It refuses what udevadm's own reader refuses, and a jump that
leads nowhere. Of the values it knows what a rules file of serial ports uses: no substitutions, no programs.
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

MATCH, EQUALS, ADD, REMOVE, FINAL = frozenset({"==", "!="}), "=", "+=", "-=", ":="
_LIST = frozenset({EQUALS, ADD, REMOVE, FINAL})
#: key -> operators it may have; those that end with {} need an attribute
KEYS: Mapping[str, frozenset[str]] = {
    **dict.fromkeys(
        ("ACTION", "DEVPATH", "KERNEL", "KERNELS", "SUBSYSTEM", "SUBSYSTEMS", "DRIVER", "DRIVERS", "TAGS", "RESULT"),
        MATCH,
    ),
    **dict.fromkeys(("ATTRS{}", "CONST{}", "TEST{}"), MATCH),
    **dict.fromkeys(("TEST", "PROGRAM"), MATCH | {EQUALS}),
    "NAME": MATCH | {EQUALS, FINAL},
    "SYMLINK": MATCH | _LIST,
    "TAG": MATCH | {EQUALS, ADD, REMOVE},
    "ATTR{}": MATCH | {EQUALS},
    "SYSCTL{}": MATCH | {EQUALS},
    "ENV{}": MATCH | {EQUALS, ADD},
    **dict.fromkeys(("OWNER", "GROUP", "MODE"), frozenset({EQUALS, FINAL})),
    "SECLABEL{}": frozenset({EQUALS, ADD, FINAL}),
    **dict.fromkeys(("RUN", "RUN{}"), frozenset({EQUALS, ADD, FINAL})),
    **dict.fromkeys(("LABEL", "GOTO"), frozenset({EQUALS})),
    "IMPORT{}": MATCH | {EQUALS},
    "OPTIONS": frozenset({EQUALS, ADD}),
}
_TOKEN = re.compile(r'\s*([A-Z]+)(?:\{([^}]*)\})?\s*(==|!=|\+=|-=|:=|=)\s*"([^"]*)"\s*(,|$)')


@dataclass(frozen=True)
class Token:
    """One key of a rule, with attribute, operator and value."""

    key: str
    attribute: str
    operator: str
    value: str

    @property
    def is_match(self) -> bool:
        """Whether it asks, or sets."""
        return self.operator in MATCH


@dataclass
class UdevDevice:
    """A device, as rules see it.

    Attributes:
        action, kernel, subsystem, driver: of the event and the device itself.
        attributes: of it; a rule may set them.
        environment: properties, such as those that 60-serial.rules imports.
        parents: the device itself first, then upwards: KERNELS, SUBSYSTEMS, DRIVERS and ATTRS ask them.
    """

    subsystem: str
    kernel: str = ""
    driver: str = ""
    action: str = "add"
    attributes: dict[str, str] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    parents: Sequence[UdevDevice] = ()
    symlinks: list[str] = field(default_factory=list)
    tags: list[str] = field(default_factory=list)
    node: dict[str, str] = field(default_factory=dict)


def read_rules(text: str) -> list[list[Token]]:
    """Return the rules of a file.

    Raises:
        ValueError: a line that udev would refuse; names it.
    """
    rules = [list(_tokens(number, line)) for number, line in enumerate(text.splitlines(), start=1)]
    rules = [rule for rule in rules if rule]
    for number, rule in enumerate(rules):
        for token in rule:
            later = {one.value for following in rules[number + 1 :] for one in following if one.key == "LABEL"}
            if token.key == "GOTO" and token.value not in later:
                raise ValueError(f"GOTO: expected a LABEL {token.value!r} further down, found none")
    return rules


def _tokens(number: int, line: str) -> Iterator[Token]:
    if not line.strip() or line.lstrip().startswith("#"):
        return
    at = 0
    while at < len(line.rstrip()):
        found = _TOKEN.match(line, at)
        if not found:
            raise ValueError(f'line {number}: expected KEY{{attribute}}OPERATOR"value", found {line[at:]!r}')
        key, attribute, operator, value, comma = found.groups()
        name = key + "{}" * (attribute is not None)
        if attribute == "" or name not in KEYS:
            raise ValueError(f"line {number}: expected a key of udev(7), found {name}")
        if operator not in KEYS[name]:
            raise ValueError(f"line {number}: {name}: expected one of {sorted(KEYS[name])}, found {operator}")
        if key == "MODE" and not re.fullmatch(r"0?[0-7]{3}", value):
            raise ValueError(f"line {number}: MODE: expected three or four octal digits, found {value!r}")
        at = found.end()
        if comma and at >= len(line.rstrip()):
            raise ValueError(f"line {number}: expected a key behind the last comma, found the end")
        yield Token(key, attribute or "", operator, value)


def apply_rules(rules: Sequence[Sequence[Token]], device: UdevDevice) -> None:
    """Do to a device what the rules say."""
    skipped_to = ""
    for rule in rules:
        if skipped_to:
            if any(one.key == "LABEL" and one.value == skipped_to for one in rule):
                skipped_to = ""
            else:
                continue
        if not _matches([one for one in rule if one.is_match], device):
            continue
        for token in rule:
            if token.key == "GOTO":
                skipped_to = token.value
            elif not token.is_match:
                _assign(token, device)


def _matches(tokens: Sequence[Token], device: UdevDevice) -> bool:
    """Whether all keys match; those of parents at one and the same parent."""
    upwards = [one for one in tokens if one.key in {"KERNELS", "SUBSYSTEMS", "DRIVERS", "ATTRS"}]
    own = [one for one in tokens if one not in upwards]
    line = (device, *device.parents)
    return all(_holds(one, device) for one in own) and (
        not upwards or any(all(_holds(one, place) for one in upwards) for place in line)
    )


def _holds(token: Token, device: UdevDevice) -> bool:
    found = {
        "ACTION": device.action,
        "KERNEL": device.kernel,
        "SUBSYSTEM": device.subsystem,
        "DRIVER": device.driver,
        "ATTR": device.attributes.get(token.attribute),
        "ENV": device.environment.get(token.attribute, ""),
    }.get(token.key.removesuffix("S") if token.key != "ATTRS" else "ATTR")
    equal = found is not None and any(fnmatch.fnmatchcase(found, one) for one in token.value.split("|"))
    return equal == (token.operator == "==")


def _assign(token: Token, device: UdevDevice) -> None:
    if token.key == "ATTR":
        device.attributes[token.attribute] = token.value
    elif token.key == "ENV":
        device.environment[token.attribute] = token.value
    elif token.key == "SYMLINK":
        device.symlinks.extend(token.value.split())
    elif token.key == "TAG":
        device.tags.append(token.value)
    elif token.key in {"MODE", "GROUP", "OWNER"}:
        device.node[token.key] = token.value

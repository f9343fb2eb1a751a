"""Robots that have ended the process that reads them, or that no robot can be: one line each."""

import pytest

from fsw.checks.urdf import MAX_LINKS, check_urdf
from fsw.errors import ConfigError
from tests.conftest import arm_urdf


def chain(links: int) -> str:
    """Return a chain of so many links, each on the one before."""
    parts = [f'<link name="l{k}"/>' for k in range(links)]
    parts += [
        f'<joint name="j{k}" type="fixed"><parent link="l{k - 1}"/><child link="l{k}"/></joint>'
        for k in range(1, links)
    ]
    return f'<robot name="r">{"".join(parts)}</robot>'


def without_a_place(value: str) -> str:
    return arm_urdf(3).replace('xyz="0 0 0.4"', f'xyz="0 0 {value}"', 1)


HOSTILE = {
    "a chain of 5000 links": (chain(5000), f"5000 links; must be at most {MAX_LINKS}"),
    "100000 links": (chain(100_000), "must be at most 1048576"),
    "5000 elements in one another": (
        "<robot>" + "<a>" * 5000 + "</a>" * 5000 + "</robot>",
        "nested deeper",
    ),
    "an origin of 1e300": (without_a_place("1e300"), "origin"),
    "an origin that is not a number": (without_a_place("nan"), "origin"),
    "a mass of 1e300": (arm_urdf(3).replace('mass value="3"', 'mass value="1e300"', 1), "mass"),
    "a joint without a name": (arm_urdf(3).replace('name="axis1"', 'name=""'), "without a name"),
    "a negative effort": (arm_urdf(3).replace('effort="', 'effort="-', 1), "effort .* at least 0"),
    "a value that xacro replaces": (
        arm_urdf(3).replace('mass value="3"', 'mass value="${m}"', 1),
        "is a xacro file",
    ),
    "a base that floats in the world": (
        arm_urdf(3).replace("revolute", "floating", 1),
        "leave out this joint and its parent",
    ),
    "an entity that expands": (
        '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><robot name="&b;"/>',
        "document type",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_robot_that_would_end_its_reader_is_refused_in_one_line(name: str):
    text, word = HOSTILE[name]
    with pytest.raises(ConfigError, match=word) as caught:
        check_urdf(text.encode())
    assert len(str(caught.value)) < 400
    assert len(str(caught.value).splitlines()) == 1


def test_as_many_links_as_may_be_pass():
    check_urdf(chain(MAX_LINKS).encode())
    check_urdf(arm_urdf(7).encode())


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_another_encoding_says_what_to_do(encoding: str):
    with pytest.raises(ConfigError, match="is not in UTF-8; save it as UTF-8"):
        check_urdf(arm_urdf(3).replace("axis1", "Gelenk ä").encode(encoding))

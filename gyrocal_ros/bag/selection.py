"""Which topic of a recording plays which role, and what to do about those that are missing."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from gyrocal_ros.bag.storage import Topic
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.topics import POSES, STATIC_TRANSFORMS, TRANSFORMS, TYPES, Role

ENDINGS = {role: (str(role),) for role in Role} | {Role.IMAGE: (Role.IMAGE, f'{Role.IMAGE}/compressed')}
CAMERA_ROLES = (Role.FEATURES, Role.IMAGE)
NEEDED_ROLES = (Role.IMU, Role.WHEELS, Role.FEATURES, Role.IMAGE, Role.CAMERA_INFO, Role.HEADING)
"""All others may be missing or broken: they only help."""

NO_COVARIATES = (
    'geometry_msgs/',
    'nav_msgs/',
    'tf2_msgs/',
    'visualization_msgs/',
    'rcl_interfaces/',
    'rosgraph_msgs/',
    *(f'sensor_msgs/msg/{name}' for name in ('Imu', 'NavSat', 'Image', 'Compressed', 'Camera', 'Point')),
)
"""Types that say how the robot moves or is set up: no physical cause of what a gyro does wrong."""


@dataclass(frozen=True, slots=True)
class TopicChoice:
    """What the user says about the topics."""

    remap: Mapping[Role, str] = field(default_factory=dict)
    """Names of topics that are not called as usual."""
    namespace: str | None = None
    """The robot, where the recording holds several."""
    heading_reference: str | None = None
    """Topic to take the heading from, in place of the ceiling camera."""
    use_images: bool = False
    """Take the images even where there are features."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The topics in use."""

    topics: Mapping[Role, Topic]
    static_transforms: tuple[Topic, ...]
    others: Mapping[str, Topic]
    """Topics that may hold covariates, by their name without namespace."""
    findings: tuple[BagIssue, ...]
    """What is missing or in doubt."""


def parse_remap(words: Iterable[str]) -> dict[str, str]:
    """Read remaps as ROS writes them.

    Args:
        words: each `NAME:=TOPIC`.

    Raises:
        ConfigError: one is written otherwise.
    """
    remap = {}
    for word in words:
        name, _, topic = word.partition(':=')
        if not (name and topic):
            raise ConfigError(f'{word!r} is no remap', todo='write NAME:=TOPIC, as in imu/data_raw:=/imu')
        remap[name.strip('/')] = topic
    return remap


def remap_roles(remap: Mapping[str, str]) -> dict[Role, str]:
    """Look up the roles of remapped names.

    Args:
        remap: usual name of a topic (`imu/data_raw`) to its name in this recording.

    Raises:
        ConfigError: no topic is usually called so.
    """
    roles = {str(role): role for role in Role if role is not Role.HEADING}
    for name in remap.keys() - roles.keys():
        close = difflib.get_close_matches(name, roles, n=1) or list(roles)
        raise ConfigError(f'cannot remap {name!r}', todo=f'known are {", ".join(close)}')
    return {roles[name]: topic for name, topic in remap.items()}


def select_topics(topics: Mapping[str, Topic], choice: TopicChoice) -> Selection:
    """Find the topic for every role.

    A topic is known by the end of its name: `/robot1/imu/data_raw` is `imu/data_raw` of `robot1`.

    Args:
        topics: all topics of the recording by name.
        choice: what the user says about them.
    """
    findings: list[BagIssue] = []
    robots = _robots(topics)
    robot = _robot(topics, robots, choice, findings)
    named = dict(choice.remap)
    if choice.heading_reference:
        named[Role.HEADING] = choice.heading_reference
    found: dict[Role, Topic] = {}
    for role in Role:
        if role in named:
            topic = _by_name(topics, named[role], findings)
        elif role is not Role.HEADING:
            topic = _by_ending(topics, role, robot, alone=len(robots) < 2 and choice.namespace is None)
        else:
            topic = None
        if topic and _is_usable(topic, role, findings):
            found[role] = topic
    _one_reference(found, choice)
    findings += _missing(topics, found, choice)
    return Selection(
        found,
        tuple(t for t in topics.values() if t.type_name == TRANSFORMS and t.name.endswith(STATIC_TRANSFORMS)),
        dict(_others(topics, found, robot, robots)),
        tuple(findings),
    )


def _namespace(name: str, ending: str) -> str | None:
    """Return what stands before the ending in a topic's name, None where it does not end so."""
    before, mark, rest = f'/{name.strip("/")}'.rpartition(f'/{ending}')
    return before.strip('/') if mark and not rest else None


def _matches(topics: Mapping[str, Topic], role: Role) -> Iterator[tuple[str, Topic]]:
    for ending in ENDINGS[role]:
        for topic in topics.values():
            namespace = _namespace(topic.name, ending)
            if namespace is not None:
                yield namespace, topic


def _robots(topics: Mapping[str, Topic]) -> list[str]:
    """Return the namespaces with an IMU; those alone that have a ceiling camera too, if any."""
    with_imu = [namespace for namespace, _ in _matches(topics, Role.IMU)]
    with_camera = {namespace for role in CAMERA_ROLES for namespace, _ in _matches(topics, role)}
    return [namespace for namespace in with_imu if namespace in with_camera] or with_imu


def _robot(
    topics: Mapping[str, Topic], robots: list[str], choice: TopicChoice, findings: list[BagIssue]
) -> str:
    if choice.namespace is not None:
        robot = choice.namespace.strip('/')
        namespaces = {namespace for role in Role for namespace, _ in _matches(topics, role)}
        if robot not in namespaces:
            known = ', '.join(sorted(f'/{namespace}' for namespace in namespaces)) or 'none'
            findings.append(
                BagIssue(
                    Severity.ERROR,
                    'no_such_robot',
                    '',
                    f'no robot has the namespace /{robot}',
                    f'known: {known}',
                )
            )
        return robot
    if len(robots) > 1 and Role.IMU not in choice.remap:
        names = ', '.join(f'/{robot}' for robot in robots)
        findings.append(
            BagIssue(
                Severity.ERROR,
                'several_robots',
                '',
                f'there are several robots: {names}',
                'choose with --namespace',
            )
        )
    return robots[0] if robots else ''


def _by_ending(topics: Mapping[str, Topic], role: Role, robot: str, *, alone: bool) -> Topic | None:
    matches = list(_matches(topics, role))
    own = [topic for namespace, topic in matches if namespace == robot]
    if not own and alone and len({namespace for namespace, _ in matches}) == 1:
        own = [topic for _, topic in matches]
    return next((topic for topic in own if topic.count), own[0] if own else None)


def _by_name(topics: Mapping[str, Topic], name: str, findings: list[BagIssue]) -> Topic | None:
    same = [topic for topic in topics.values() if topic.name.strip('/') == name.strip('/')]
    same += [topic for topic in topics.values() if _namespace(topic.name, name.strip('/')) is not None]
    if same:
        return same[0]
    close = difflib.get_close_matches(name, list(topics), n=1, cutoff=0.5)
    todo = f'did you mean {close[0]}?' if close else f'there are {", ".join(topics)}'
    findings.append(BagIssue(Severity.ERROR, 'missing_topic', name, 'there is no such topic', todo))
    return None


def _is_usable(topic: Topic, role: Role, findings: list[BagIssue]) -> bool:
    severity = Severity.ERROR if role in NEEDED_ROLES else Severity.WARNING
    if topic.type_name not in TYPES[role]:
        text = f'is a {topic.type_name}, not a {" or ".join(TYPES[role])}'
        findings.append(BagIssue(severity, 'wrong_type', topic.name, text, f'name another topic as {role}'))
        return False
    if not topic.count:
        findings.append(
            BagIssue(Severity.WARNING, 'empty_topic', topic.name, 'has no messages', 'was its node running?')
        )
        return False
    return True


def _one_reference(found: dict[Role, Topic], choice: TopicChoice) -> None:
    """Leave one heading reference: another topic if named, else the features, else the images."""
    unused: tuple[Role, ...] = ()
    if choice.heading_reference:
        unused = (*CAMERA_ROLES, Role.CAMERA_INFO)
    elif Role.FEATURES in found and not (choice.use_images and Role.IMAGE in found):
        unused = (Role.IMAGE,)
    elif Role.IMAGE in found:
        unused = (Role.FEATURES,)
    for role in unused:
        found.pop(role, None)


def _missing(
    topics: Mapping[str, Topic], found: Mapping[Role, Topic], choice: TopicChoice
) -> Iterator[BagIssue]:
    def missing(role: Role, text: str, todo: str = '', severity: Severity = Severity.ERROR) -> BagIssue:
        return BagIssue(severity, 'missing_topic', str(role), text, todo or _advice(topics, found, role))

    if Role.IMU not in found:
        yield missing(Role.IMU, 'there is no IMU')
    if Role.WHEELS not in found:
        severity = Severity.NOTE if choice.heading_reference else Severity.ERROR
        yield missing(Role.WHEELS, 'there is no wheel odometry', severity=severity)
    if choice.heading_reference:
        if Role.HEADING in found and found[Role.HEADING] == found.get(Role.TRUTH):
            yield BagIssue(
                Severity.ERROR,
                'truth_as_reference',
                found[Role.HEADING].name,
                'the ground truth is only compared with, never calibrated from',
                'name another heading reference',
            )
        return
    if not any(role in found for role in CAMERA_ROLES):
        others = [
            topic.name
            for topic in topics.values()
            if topic.type_name in POSES and topic not in (found.get(Role.TRUTH), found.get(Role.WHEELS))
        ]
        instead = f'--heading-reference {" or ".join(others)}' if others else '--heading-reference TOPIC'
        advice = _advice(topics, found, Role.IMAGE)
        yield missing(Role.IMAGE, 'there is no ceiling camera', f'{advice}, or give {instead}')
    elif Role.CAMERA_INFO not in found:
        yield missing(Role.CAMERA_INFO, 'the camera has no calibration')


def _advice(topics: Mapping[str, Topic], found: Mapping[Role, Topic], role: Role) -> str:
    """Name the topics that may be meant."""
    free = [topic for topic in topics.values() if topic not in found.values()]
    fitting = [topic.name for topic in free if topic.type_name in TYPES[role]]
    if len(fitting) == 1:
        return f'give -r {role}:={fitting[0]}'
    if fitting:
        return f'give -r {role}:=TOPIC with one of {", ".join(fitting)}'
    close = difflib.get_close_matches(str(role), [topic.name.strip('/') for topic in free], n=1)
    return f'did you mean {close[0]}?' if close else f'record {role}'


def _others(
    topics: Mapping[str, Topic], found: Mapping[Role, Topic], robot: str, robots: list[str]
) -> Iterator[tuple[str, Topic]]:
    strangers = tuple(f'/{other}/' for other in robots if other not in ('', robot))
    for topic in topics.values():
        name = f'/{topic.name.strip("/")}'
        used = topic in found.values() or topic.type_name.startswith(NO_COVARIATES)
        if topic.count and not used and not name.startswith(strangers):
            yield name.removeprefix(f'/{robot}' if robot else '').strip('/'), topic

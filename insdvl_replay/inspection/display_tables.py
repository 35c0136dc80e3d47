"""What a log holds, as tables for people."""

import msgspec

from insdvl_replay.inspection.inventory import Inventory, TopicFacts
from insdvl_replay.report.display_table import MISSING, CellText, ShownTable, number


def inventory_tables(inventory: Inventory) -> list[ShownTable]:
    """Lay out roles, conventions, topics and clocks.

    Parameters
    ----------
    inventory : Inventory

    Returns
    -------
    list of ShownTable
        Tables without rows are left out.
    """
    tables = (_roles(inventory), _conventions(inventory), _topics(inventory), _clocks(inventory))
    return [table for table in tables if table.rows]


def _roles(inventory: Inventory) -> ShownTable:
    return ShownTable(
        "Roles",
        ("role", "topic", "why"),
        "lll",
        tuple((role.role, role.topic or MISSING, role.reason) for role in inventory.roles),
    )


def _conventions(inventory: Inventory) -> ShownTable:
    return ShownTable(
        "Conventions: what the type of a topic says where the configuration does not",
        ("topic", "key and value"),
        "ll",
        tuple(
            (topic, tuple(f"{key} = {msgspec.json.encode(value).decode()}" for key, value in keys.items()))
            for topic, keys in inventory.conventions.items()
        ),
    )


def _topics(inventory: Inventory) -> ShownTable:
    empty = [topic for topic in inventory.topics if not topic.messages]
    return ShownTable(
        "Topics: rate, longest gap and span by the times of recording",
        ("topic\n  type, encoding", "role", "messages", "rate\n[Hz]", "gap\n[s]", "from\n[s]", "to\n[s]"),
        "llrrrrr",
        tuple(_topic(topic) for topic in inventory.topics if topic.messages),
        f"without messages: {', '.join(topic.topic for topic in empty)}" if empty else "",
    )


def _topic(topic: TopicFacts) -> tuple[CellText, ...]:
    # Some recorders name a topic after its type; once is enough.
    type_name = "" if topic.type_name == topic.topic else f"{topic.type_name or 'no type'}, "
    return (
        (topic.topic, f"  {type_name}{topic.encoding or 'no encoding'}"),
        topic.role,
        str(topic.messages),
        *(MISSING if value is None else f"{value:.3g}" for value in (topic.rate_hz, topic.longest_gap_s)),
        *(MISSING if value is None else f"{value:.0f}" for value in (topic.start_s, topic.end_s)),
    )


def _clocks(inventory: Inventory) -> ShownTable:
    messages = {topic.topic: topic.messages for topic in inventory.topics}
    return ShownTable(
        "Clocks: log time minus stamp, by the first messages",
        ("topic", "stamp", "first", "median\n[s]", "spread\n[s]", "back\nsteps", "repeats", "rate\n[Hz]"),
        "llrrrrrr",
        tuple(
            (
                clock.topic,
                clock.stamp,
                "all" if clock.messages == messages.get(clock.topic) else str(clock.messages),
                number(clock.log_minus_stamp_s),
                number(clock.spread_s),
                str(clock.back_steps),
                str(clock.repeats),
                number(clock.rate_hz),
            )
            for clock in inventory.clocks
        ),
    )

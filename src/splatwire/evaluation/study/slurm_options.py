"""Options of jobs on a Slurm cluster."""

from dataclasses import dataclass

from splatwire.errors import InvalidValueError


@dataclass(frozen=True)
class SlurmOptions:
    """Partition, account, time limit and memory of Slurm jobs.

    Attributes:
        partition: Partition of the cluster; None for its default.
        account: Account to charge; None for the user's default.
        minutes: Time limit of a job, minutes.
        memory_gb: Memory of a job, GB.

    Raises:
        InvalidValueError: If a number is not positive, or a name is empty or contains white space.
    """

    partition: str | None = None
    account: str | None = None
    minutes: int = 240
    memory_gb: int = 8

    def __post_init__(self) -> None:
        for option, number in (("minutes", self.minutes), ("memory_gb", self.memory_gb)):
            if number < 1:
                raise InvalidValueError(f"{option} of a Slurm job must be 1 or more, not {number}")
        for option, name in (("partition", self.partition), ("account", self.account)):
            if name is not None and (not name or name.split() != [name]):
                raise InvalidValueError(f"the {option} of a Slurm job is one word, not {name!r:.60}")

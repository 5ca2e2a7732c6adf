"""Sets a table with five seats."""

from dataclasses import dataclass

from household import kitchen


@dataclass
class TableFull(Exception):
    seats: int
    guests: int

    def __str__(self):
        return f"{self.guests} guests, but {self.seats} seats"


def assign_seats(guests, seats=5):
    free = list(range(seats))
    if len(guests) > len(free):
        raise TableFull(seats, len(guests))  # @cause
    return dict(zip(guests, free, strict=False))


world = kitchen(plate=[1.4, 0.8, 0.865])
assign_seats(["Ann", "Ben", "Cem", "Dora", "Eva", "Finn"])  # @call

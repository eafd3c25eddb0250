"""When to give up an old factorisation: the rule alone, without matrices."""

from math import ceil, log

__all__ = ["Ageing"]


class Ageing:
    """How many iterations the age of a preconditioner has cost.

    A solve that brings the excess of its residual, a squared norm in units of what is allowed, from
    `start` below 1 takes log(start) / rate iterations, where rate is the reduction of log(excess)
    by one iteration. While the preconditioner is new, the rate is measured; what later solves take
    beyond that is lost to its age.

    Parameters
    ----------
    price : int
        What a new preconditioner costs, in iterations.

    Attributes
    ----------
    price : int
    lost : int
        Iterations that the age has cost.
    rate : float
        Reduction of log(excess) by one iteration in the first solve that took any; 0 until then.

    Examples
    --------
    >>> ageing = Ageing(price=5)
    >>> ageing.record(iterations=2, start=1e8, end=1.0)  # new: a factor of 1e4 by one iteration
    >>> ageing.record(iterations=6, start=1e8, end=1.0)  # two would have done
    >>> ageing.lost, ageing.due
    (4, False)
    >>> ageing.record(iterations=2, start=1e4, end=1.0)
    >>> ageing.lost, ageing.due
    (5, True)
    """

    def __init__(self, price: int) -> None:
        self.price = price
        self.lost = 0
        self.rate = 0.0

    @property
    def due(self) -> bool:
        """Whether the age has cost as much as a new preconditioner."""
        return self.lost >= self.price

    def record(self, iterations: int, start: float, end: float) -> None:
        """Count a solve that converged.

        Parameters
        ----------
        iterations : int
        start, end : float
            The excess before the first and after the last of them.
        """
        if iterations == 0:
            return
        if self.rate == 0:
            self.rate = log(start / max(end, 1e-30)) / iterations
        else:
            self.lost += max(0, iterations - ceil(log(start) / self.rate))

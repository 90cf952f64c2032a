"""What motion and the DVL's beams say of a depth that a network claims."""

from dream.perception.parallax.check import Checked, Parallax

__all__ = ["Checked", "Parallax"]

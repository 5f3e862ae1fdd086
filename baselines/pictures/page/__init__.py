"""The page that shows plans in three dimensions, moving, with their verdicts: one HTML file, all in it.

Python follows a plan once more and packs what is seen (`surface`, `motion`, `pack`); `compose` puts it into
page.html with the words, page.css, the scripts, and three.js (three.min.js, made by tools/three).
"""

from baselines.pictures.page.compose import Shown, Table, Tried, page
from baselines.pictures.page.motion import Motion, NotFollowed, followed, followed_by_rod

__all__ = ["Motion", "NotFollowed", "Shown", "Table", "Tried", "followed", "followed_by_rod", "page"]

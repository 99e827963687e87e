"""Whose the frame of the robot is: a frame has one parent, and one who says where it is."""

from __future__ import annotations

from collections import OrderedDict

from tf2_msgs.msg import TFMessage

from whereabouts.nodes.messages.stamps import nanoseconds
from whereabouts.nodes.messages.transforms import TransformBuffer, frame_name

# Of a node's own transforms, to know them when they come back.
REMEMBERED = 500
# Foreign transforms from which on somebody else is sure to publish them: one may be left over from before a restart.
SURE = 3


class FrameOwner:
    """Decides whether a node may publish `parent` -> `child`.

    withheld : why it may not, as a sentence; empty while it may.
    """

    def __init__(self, parent: str, child: str) -> None:
        self._parent, self._child = frame_name(parent), frame_name(child)
        self._own: OrderedDict[int, None] = OrderedDict()
        self._foreign = 0
        self.withheld = ""

    def hear(self, message: TFMessage) -> None:
        """Look at what comes on tf, for the same transform by somebody else."""
        for item in message.transforms:
            if frame_name(item.child_frame_id) != self._child:
                continue
            same = frame_name(item.header.frame_id) == self._parent
            if same and nanoseconds(item.header.stamp) not in self._own:
                self._foreign += 1

    def takes(self, stamp: int, transforms: TransformBuffer) -> bool:
        """Whether the node may publish its transform of `stamp`, ns; it is taken to do so then."""
        link = f"'{self._parent}' -> '{self._child}'"
        parent = transforms.parent(self._child)
        if parent not in (None, self._parent):
            chain = [parent]
            while (above := transforms.parent(chain[-1])) and above not in (self._parent, *chain):
                chain.append(above)
            self.withheld = (
                f"the transform {link} is withheld: '{self._child}' has the parent '{parent}' already. Set base_frame: "
                f"{chain[-1]} for all nodes, or publish_tf: false for this one"
            )
        elif self._foreign >= SURE:
            self.withheld = (
                f"the transform {link} is withheld: somebody else publishes it. Set publish_tf: false, or switch "
                "it off there"
            )
        if self.withheld:
            return False
        self._own[stamp] = None
        while len(self._own) > REMEMBERED:
            self._own.popitem(last=False)
        return True

"""What all nodes share, so that a node is only its own few lines.

A node derives from `SuiteNode`, names its parameter model and implements `setup` (create inputs, outputs and
services), `start_run` (forget live state) and, if it has something to say, `health`.

Threads: every node runs on one single-threaded executor. No callback may wait for another one. Transforms are
looked up without blocking (a message whose transform is still to come waits in its `Input`), and long actions
are coroutines that yield, so that a cancel, a look-up or a service call can always be served.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Coroutine
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import rclpy
from rclpy.action.server import ActionServer
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.task import Future
from tf2_msgs.msg import TFMessage

from estimation.errors import InputError, WhereaboutsError
from whereabouts.nodes.messages.transforms import TransformBuffer
from whereabouts.nodes.ros.bonding import Bonding
from whereabouts.nodes.ros.declared_parameters import ParameterError, ParameterSet
from whereabouts.nodes.ros.diagnostics import Complaints, DiagnosticsPublisher, Health
from whereabouts.nodes.ros.executor import NodeExecutor
from whereabouts.nodes.ros.footprint import keep_packed, release, settle, use_small_segment
from whereabouts.nodes.ros.guarded_calls import guarded_action, guarded_answer
from whereabouts.nodes.ros.host import ACTIVE_VARIABLE, SUPERVISOR_VARIABLE
from whereabouts.nodes.ros.inputs import Handler, Input
from whereabouts.nodes.ros.outputs import QUIET, Output, OutputAccount
from whereabouts.nodes.ros.qos import HEARD_LATCHED, TF_QOS, TF_STATIC_QOS
from whereabouts.nodes.ros.timekeeping import Timekeeper
from whereabouts.nodes.ros.turns import Caller, Turns
from whereabouts.parameters.parameter_base import NodeParameters
from whereabouts.system.interrupts import interrupts_kept, listen_to_interrupts
from whereabouts_msgs.srv import Reset

HOUSEKEEPING_PERIOD = 0.2
NodeType = TypeVar("NodeType", bound="SuiteNode")


class SuiteNode(LifecycleNode):
    """A lifecycle node with validated parameters, accounted inputs, tf and diagnostics.

    settings : the current parameters, an instance of `parameters_model`.
    active : whether the lifecycle state is active; inputs and timers rest otherwise.
    epoch : number of the run; counts up when time goes back. last_run : why the last one began.
    time : what the stamps of all sensors tell. turns : what is kept in a lock-step replay until it is its turn.
    complaints : what was warned of; alarm, complain, report_defect : its own. account : of what was sent. created : how
    to take down what `setup` has made.
    sends_clouds : whether it sends messages of megabytes, clouds or maps; see `use_small_segment`.
    """

    parameters_model: ClassVar[type[NodeParameters]] = NodeParameters
    node_name: ClassVar[str] = ""
    sends_clouds: ClassVar[bool] = False

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(self.node_name, **kwargs)
        self._parameter_set = ParameterSet(self, self.parameters_model)
        self.active = False
        self.epoch = 0
        self.complaints = Complaints(self.get_logger())
        self.alarm, self.complain = self.complaints.alarm, self.complaints.complain
        self.report_defect = self.complaints.report_defect
        self.last_run = ""
        self.time = Timekeeper(self)
        # In lock-step on recorded time: what follows has to be the same each time.
        self.replayed = bool(self.settings.report_processed and self.get_parameter("use_sim_time").value)
        self.turns = Turns(self)
        self.created = ExitStack()
        self.inputs: list[Input] = []
        self.outputs: list[Output] = []
        self.transforms = TransformBuffer()
        self.account = OutputAccount(self)
        self._diagnostics = DiagnosticsPublisher(self)
        self._bonding = Bonding(self)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(self.settings.diagnostics_period, self._diagnostics.publish, clock=self._steady)
        self._supervisor = int(os.environ.get(SUPERVISOR_VARIABLE, 0))
        self.create_timer(HOUSEKEEPING_PERIOD, self._keep_house, clock=self._steady)

    @property
    def settings(self) -> Any:
        return self._parameter_set.values

    @property
    def resting(self) -> list[Any]:
        """Subscriptions whose messages may lie about until something else wakes the node up."""
        if self.turns.on:
            return self.turns.resting
        waits = any(item.waiting for item in self.inputs)
        return [
            item.subscription
            for item in self.inputs
            if item.on_demand and not (waits and (item.is_transforms or item.awaited))
        ]

    @property
    def own(self) -> list[Any]:
        """Subscriptions whose messages are taken in when it is the node's turn."""
        return self.turns.own if self.turns.on else []

    # What a node implements.

    def setup(self) -> None:
        """Create inputs, outputs, timers and services."""

    def start_run(self) -> None:
        """Forget live state: somebody asked for it, or the node starts."""

    def next_run(self) -> None:
        """Time jumped back: forget live state, but for what is worth to be taken up again."""
        self.start_run()

    def health(self) -> Health:
        """The node's own judgement of how it is doing."""
        return Health()

    # What a node uses.

    def add_input(self, message_type: type, topic: str, handler: Handler, **options: Any) -> Input:
        """Subscribe a topic; options as of `Input`."""
        item = Input(self, message_type, topic, handler, **options)
        self.inputs.append(item)
        self.created.callback(self.destroy_subscription, item.subscription)
        return item

    def add_latched_input(self, message_type: type, topic: str, handler: Handler) -> Input:
        """Subscribe a state that is kept for those who come late, such as a map."""
        return self.add_input(message_type, topic, handler, qos=HEARD_LATCHED, sensor=False)

    def add_action(
        self, action_type: type, name: str, execute: Callable[[Any], Coroutine[Any, Any, Any]]
    ) -> ActionServer:
        """Serve an action by a coroutine; goals are refused while the node is inactive, cancels always accepted.

        A `WhereaboutsError` in it becomes a result that says so, with the code REFUSED.
        """
        server = guarded_action(self, action_type, name, execute)
        self.created.callback(server.destroy)
        return server

    def add_caller(self, action_type: type, name: str) -> Caller:
        """Call an action; see `Caller`."""
        caller = Caller(self, action_type, name)
        self.created.callback(caller.client.destroy)
        return caller

    async def pause(self, seconds: float) -> None:
        """Let other callbacks run for a while; for coroutines of actions. In a replay by message time."""
        if self.turns.on:
            await self.turns.rest(seconds)
            return
        done = Future()
        timer = self.create_timer(seconds, lambda: done.set_result(None), clock=self._steady)
        try:
            await done
        finally:
            self.destroy_timer(timer)

    def add_output(self, message_type: type, topic: str, qos: QoSProfile | int = 10) -> Output:
        """A counted publisher that is silent while the node is inactive."""
        publisher = self.create_lifecycle_publisher(message_type, topic, qos, event_callbacks=QUIET)
        self.created.callback(self.destroy_lifecycle_publisher, publisher)
        output = Output(publisher)
        self.outputs.append(output)
        return output

    def add_timer(self, period: float, callback: Callable[[], None]) -> None:
        """Call back every `period` seconds of the node's ROS clock, in a replay of message time, while it is active."""

        def tick() -> None:
            if not self.active:
                return
            try:
                callback()
            except WhereaboutsError as error:
                self.complain(str(error), key=callback)
            except Exception as error:
                self.report_defect(f"timer {getattr(callback, '__name__', '')}", error)

        if self.replayed:
            self.time.call_every(period, tick)
            return
        timer = self.create_timer(period, tick)
        self.created.callback(self.destroy_timer, timer)

    def add_service(self, service_type: type, name: str, callback: Callable[[Any, Any], str | None]) -> None:
        """Offer a service.

        callback : fills a response, and returns what was done in a sentence where the response has a place for that. A
        `WhereaboutsError` in it becomes a refusal with its sentence, any other exception a failure.
        """
        service = self.create_service(service_type, name, guarded_answer(self, service_type, name, callback))
        self.created.callback(self.destroy_service, service)

    def listen_to_transforms(self, on_demand: bool = False) -> None:
        """Subscribe tf and tf_static. on_demand : for nodes that seldom look where anything is; see `Input`."""
        for topic, static, qos in (("tf", False, TF_QOS), ("tf_static", True, TF_STATIC_QOS)):

            def handle(message: TFMessage, _: int, static: bool = static) -> None:
                self._take_transforms(message, static)

            rests = on_demand and not static
            self.add_input(TFMessage, topic, handle, qos=qos, sensor=False, on_demand=rests)

    @property
    def now(self) -> int:
        """ns that the node's clock shows; in a lock-step replay, what the stamps say, as /clock comes at any moment."""
        now = self.time.clocks.now if self.turns.on else None
        return int(self.get_clock().now().nanoseconds) if now is None else now

    def broadcaster(self) -> Output:
        """A publisher for tf; give it lists of transforms in a TFMessage."""
        return self.add_output(TFMessage, "tf", TF_QOS)

    def begin_run(self, reason: str, counted: bool = True) -> None:
        """Time went back: a new epoch, with a warning. What is known for good stays.

        counted : false where nothing is lost, as no more than one message has been taken before.
        """
        self._end_run(f"a new run begins: {reason}" if counted else f"first of all, {reason}", counted)
        self.next_run()

    def _end_run(self, reason: str, counted: bool = True) -> None:
        self.epoch += counted
        self.last_run = reason
        self.alarm(reason)
        for item in self.inputs:
            item.new_run()

    # Lifecycle.

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._parameter_set.freeze(True)
        try:
            self.setup()
            self.add_service(Reset, "~/reset", self._reset)
            if self.replayed:
                self.turns.listen()
            self.start_run()
        except Exception as error:
            if isinstance(error, WhereaboutsError):
                self.get_logger().error(f"cannot configure: {error}")
            else:
                self.report_defect("configure", error)
            self._destroy_created()
            self._parameter_set.freeze(False)
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_activate(state)
        self.active = result == TransitionCallbackReturn.SUCCESS
        if self.active:
            self._bonding.form()
        mark = os.environ.get(ACTIVE_VARIABLE)
        if self.active and mark:
            Path(mark).touch()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.active = False
        self._bonding.end()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._destroy_created()
        self.time.stop()
        self._parameter_set.freeze(False)
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.active = False
        self._bonding.end()
        self._destroy_created()
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """Also where the process is told to end without a transition: what is open is closed."""
        self.created.close()
        super().destroy_node()

    def _destroy_created(self) -> None:
        self.created.close()
        self.inputs.clear()
        self.outputs.clear()
        self.turns.clear()
        self.transforms = TransformBuffer()

    def _reset(self, request: Reset.Request, response: Reset.Response) -> str:
        self._end_run(f"reset: {request.reason or 'it was asked for'}")
        self.time.begin()
        self.start_run()
        return "started afresh"

    def _keep_house(self) -> None:
        """All that is due now and then, in one timer: each wakes the node up."""
        if self._supervisor and os.getppid() != self._supervisor:
            self.get_logger().error("the supervisor is gone: ending")
            raise KeyboardInterrupt
        # In a replay only messages change what there is to go on with.
        if self.turns.on:
            self.turns.look_around()
        else:
            self.serve_waiting()
        if self.active:
            self.time.mind_silence()
            for item in self.inputs:
                item.serve_shed()
            self.account.report_connections()

    def _take_transforms(self, message: TFMessage, static: bool) -> None:
        problem: InputError | None = None
        for transform in message.transforms:
            try:
                self.transforms.insert(transform, static)
            except InputError as error:
                problem = error
        self.serve_waiting(reported=not any(item.on_demand and item.is_transforms for item in self.inputs))
        if problem is not None:
            raise problem

    def serve_waiting(self, reported: bool = False) -> None:
        """Go on with what waits for transforms, if they have come; see `Input.serve_waiting`."""
        if self.active:
            for item in self.inputs:
                item.serve_waiting(reported)


def run_node(node_type: type[NodeType]) -> int:
    """Run one node until it is told to stop; the body of every executable.

    Returns the exit code: 0 after SIGINT or SIGTERM, 1 for an error, 2 for wrong parameters.
    """
    listen_to_interrupts()
    if not node_type.sends_clouds:
        use_small_segment()
    rclpy.init()
    keep_packed()
    node: NodeType | None = None
    try:
        with interrupts_kept():
            node = node_type()
            if node.settings.autostart and not start(node):
                return 1
            settle()
            _spin(node)
    except ParameterError as error:
        print(f"{node_type.node_name}: {error}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        traceback.print_exc()
        return 1
    finally:
        if node is not None:
            node.destroy_node()
        _shut_down()
        # The middleware gives its shared memory back once nothing refers to the node any more.
        del node
        release()
    return 0


def _shut_down() -> None:
    """Shut the context down, unless the thread that hears of signals comes first, at this very moment."""
    try:
        rclpy.try_shutdown()  # type: ignore[attr-defined]
    except RuntimeError:
        if rclpy.ok():  # type: ignore[attr-defined]
            raise


def _spin(node: SuiteNode) -> None:
    executor = NodeExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    finally:
        executor.shutdown()


def start(node: SuiteNode) -> bool:
    """Configure and activate; whether both succeeded."""
    return (
        node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        and node.trigger_activate() == TransitionCallbackReturn.SUCCESS
    )


def exit_with(node_type: type[SuiteNode]) -> None:
    """Run a node and leave the process without tearing down Python, which middleware threads can hang on."""
    code = run_node(node_type)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)

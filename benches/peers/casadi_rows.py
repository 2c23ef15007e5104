"""The CasADi rows: the same problems as NLPs, their functions generated as C and compiled, each solve warm from the shifted last one.

The time of a solve is CasADi's own (stats()["t_wall_total"]): from the solver's entry to its return, without Python.
"""
import hashlib
import json
import os
import subprocess

import casadi as ca
import numpy as np


class Instances:
    """One recorded set along one trajectory, as the solvers' parameter vectors."""

    def __init__(self, path):
        with open(path) as file:
            instances = json.load(file)["instances"]
        first = instances[0]
        self.is_paper = first["kind"] == "paper"
        self.n_x, self.n = first["n_x"], first["horizon_n"]
        self.period, self.radius, self.lag = first["dt_s"], first["sphere_radius_m"], first["lag_tau_s"]
        self.u_min, self.u_max = np.array(first["u_min_mps_rad"]), np.array(first["u_max_mps_rad"])
        self.starts = [np.array(i["x0_m_m_rad_mps_rad"]) for i in instances]
        self.measured = [np.array(i["u_prev_mps_rad"]) for i in instances]
        self.u_ref = [np.array(i["uref_mps_rad"]) for i in instances]
        self.p = [
            np.concatenate(
                [
                    i["x0_m_m_rad_mps_rad"],
                    i["u_prev_mps_rad"],
                    np.ravel(i["xref_1_to_n_m_m_rad_mps_rad"]),
                    np.ravel(i["uref_mps_rad"]),
                    i["q_diag_per_m2_m2_rad2_mps2_rad2"],
                    np.ravel(i["p_terminal_matrix"], order="F"),
                    i["r_diag_per_mps2_rad2"],
                ]
            )
            for i in instances
        ]


class Model:
    """The NLP of a set: the inputs alone (`single` shooting), or states and inputs knot by knot (`multiple`), for solvers that use the
    structure with a state behind every input (`tailed`): of the paper's problem the last input moves no state that is weighed."""

    def __init__(self, data, shooting):
        is_single = shooting == "single"
        self.data, self.is_single = data, is_single
        n, n_x = data.n, data.n_x
        step = knot(data)
        self.step = step
        p = ca.SX.sym("p", len(data.p[0]))
        sizes = np.cumsum([0, n_x, 2, n * n_x, n * 2, n_x, n_x * n_x, 2])
        parts = [p[int(a) : int(b)] for a, b in zip(sizes[:-1], sizes[1:])]
        x0, measured, x_ref, u_ref = parts[0], parts[1], ca.reshape(parts[2], n_x, n), ca.reshape(parts[3], 2, n)
        q, terminal, r = ca.diag(parts[4]), ca.reshape(parts[5], n_x, n_x), ca.diag(parts[6])

        # Of the paper's problem U(0) is measured, so that x1 is known: the first state that stands in the NLP.
        first = step(x0, measured) if data.is_paper else x0
        begin = 1 if data.is_paper else 0
        inputs = [ca.SX.sym(f"u{k}", 2) for k in range(n)]
        states, w, g = [first], [], []
        self.u_at, self.x_at, equality = [], [], []

        def append(variable):
            at = sum(v.numel() for v in w)
            w.append(variable)
            return at

        if not is_single:
            states = [ca.SX.sym("x0", n_x)]
            self.x_at.append(append(states[0]))
        for k in range(n):
            self.u_at.append(append(inputs[k]))
            if k + begin < n or shooting == "tailed":
                after = step(states[-1], inputs[k])
                if not is_single:
                    state = ca.SX.sym(f"x{k + 1}", n_x)
                    self.x_at.append(append(state))
                    g.append(state - after)
                    after = state
                states.append(after)
            if k == 0 and not is_single:
                g.append(states[0] - first)

        cost = 0
        for k, u in enumerate(inputs):
            e = u - u_ref[:, k]
            cost += e.T @ r @ e
        # Row i of the references is that of x_(i + 1).
        weighed = states[:n] if data.is_paper else states[1:]
        for i, x in enumerate(weighed):
            e = x - x_ref[:, i]
            cost += e.T @ (terminal if i == n - 1 else q) @ e

        self.w, self.g, self.f, self.p = ca.vertcat(*w), ca.vertcat(*g) if g else ca.SX(0, 1), cost, p
        self.n_w, self.n_g = self.w.numel(), self.g.numel()
        self.lower, self.upper = np.full(self.n_w, -np.inf), np.full(self.n_w, np.inf)
        for at in self.u_at:
            self.lower[at : at + 2], self.upper[at : at + 2] = data.u_min, data.u_max

    def nlp(self):
        return {"x": self.w, "p": self.p, "f": self.f, "g": self.g}

    def inputs_of(self, w):
        return np.array([w[at : at + 2] for at in self.u_at])

    def cold(self, tick):
        """The reference inputs, rolled out."""
        data = self.data
        w = np.zeros(self.n_w)
        u = np.clip(data.u_ref[tick], data.u_min, data.u_max)
        x = self.first_state(tick)
        for k, at in enumerate(self.u_at):
            w[at : at + 2] = u[k]
            if k < len(self.x_at):
                w[self.x_at[k] : self.x_at[k] + data.n_x] = x
                x = np.array(self.step(x, u[k])).ravel()
        if len(self.x_at) > len(self.u_at):
            w[self.x_at[-1] :] = x
        return w

    def first_state(self, tick):
        x0 = self.data.starts[tick]
        return np.array(self.step(x0, self.data.measured[tick])).ravel() if self.data.is_paper else x0

    def shifted(self, tick, w, lam_x, lam_g):
        """The last solution and its multipliers, a knot on; the state of now in its place."""
        n_x = self.data.n_x
        w, lam_x, lam_g = w.copy(), lam_x.copy(), lam_g.copy()
        for rows, width in ((self.u_at, 2), (self.x_at, n_x)):
            for here, there in zip(rows[:-1], rows[1:]):
                w[here : here + width] = w[there : there + width]
                lam_x[here : here + width] = lam_x[there : there + width]
        if not self.is_single:
            # Gaps, of which the second row is the first state's; its multiplier is that of a gap one knot earlier.
            gaps = [0] + [n_x * (i + 1) for i in range(1, self.n_g // n_x - 1)]
            first, start = lam_g[gaps[0] : gaps[0] + n_x].copy(), n_x
            for here, there in zip(gaps[:-1], gaps[1:]):
                lam_g[here : here + n_x] = lam_g[there : there + n_x]
            lam_g[start : start + n_x] = first
            x = self.first_state(tick)
            # A heading is the same after a turn.
            turns = 2 * np.pi * round((x[2] - w[self.x_at[0] + 2]) / (2 * np.pi))
            for at in self.x_at:
                w[at + 2] += turns
            w[self.x_at[0] : self.x_at[0] + n_x] = x
        return w, lam_x, lam_g


def knot(data):
    """The state after a knot: the arc of eq (2), or the centre's with the reference lag. sin(h)/h as its series: no 0/0."""
    x, u = ca.SX.sym("x", data.n_x), ca.SX.sym("u", 2)
    dt, radius = data.period, data.radius

    def sinc(h):
        z = h * h
        return 1 - z / 6 * (1 - z / 20 * (1 - z / 42 * (1 - z / 72 * (1 - z / 110 * (1 - z / 156)))))

    if data.n_x == 3:
        h = u[0] * ca.tan(u[1]) / radius * dt / 2
        d = u[0] * dt * sinc(h)
        after = ca.vertcat(x[0] + d * ca.cos(x[2] + h), x[1] + d * ca.sin(x[2] + h), x[2] + 2 * h)
        return ca.Function("knot", [x, u], [after])
    left = np.exp(-dt / data.lag)
    mean = data.lag * (1 - left) / dt
    v, q = u[0] + (x[3] - u[0]) * mean, u[1] + (x[4] - u[1]) * mean
    v_after, q_after = u[0] + (x[3] - u[0]) * left, u[1] + (x[4] - u[1]) * left
    h = v * ca.tan(q) / radius * dt / 2
    d, e = v * dt * sinc(h), radius * (q_after - x[4]) * sinc(h)
    cos, sin = ca.cos(x[2] + h), ca.sin(x[2] + h)
    after = ca.vertcat(x[0] + d * cos - e * sin, x[1] + d * sin + e * cos, x[2] + 2 * h, v_after, q_after)
    return ca.Function("knot", [x, u], [after])


class Row:
    """One solver on one NLP."""

    def __init__(self, name, plugin, shooting, options):
        self.name, self.plugin, self.shooting, self.options = name, plugin, shooting, options

    def build(self, data, folder, label):
        """Generates the functions that the solver calls as C, and compiles them into `folder`."""
        self.model = Model(data, self.shooting)
        options = {"print_time": False, "record_time": True, "error_on_fail": False, **self.options}
        if self.plugin == "fatrop":
            options["equality"] = [True] * self.model.n_g
        symbolic = ca.nlpsol("solver", self.plugin, self.model.nlp(), options)
        source = f"{label}_{self.plugin}_{self.shooting}.c"
        symbolic.generate_dependencies(source)
        library = compiled(source, folder)
        self.solver = ca.nlpsol("solver", self.plugin, library, options)

    def run(self, ticks):
        """One pass over the instances, the first from the references: times [µs], iterations, solved, inputs."""
        model, data = self.model, self.model.data
        times, iterations, solved, inputs = [], [], [], []
        zero_g = np.zeros(model.n_g)
        w = lam_x = lam_g = None
        for tick in ticks:
            if w is None:
                w0, lam_x0, lam_g0 = model.cold(tick), np.zeros(model.n_w), zero_g
            else:
                w0, lam_x0, lam_g0 = model.shifted(tick, w, lam_x, lam_g)
            try:
                found = self.solver(
                    x0=w0, lam_x0=lam_x0, lam_g0=lam_g0, p=data.p[tick], lbx=model.lower, ubx=model.upper, lbg=zero_g, ubg=zero_g
                )
                stats = self.solver.stats()
                point = np.array(found["x"]).ravel()
                is_solved = bool(stats["success"]) and bool(np.all(np.isfinite(point)))
            except RuntimeError:
                # A QP that failed may end the solve by an exception.
                stats, point, is_solved = {"t_wall_total": 0.0, "iter_count": 0}, w0, False
            times.append(1e6 * stats["t_wall_total"])
            iterations.append(int(stats["iter_count"]))
            solved.append(is_solved)
            inputs.append(model.inputs_of(point))
            w = None
            if is_solved:
                w, lam_x, lam_g = point, np.array(found["lam_x"]).ravel(), np.array(found["lam_g"]).ravel()
        return {"name": self.name, "times": times, "iterations": iterations, "solved": solved, "u": np.array(inputs)}


def compiled(source, folder):
    """The library made from a C file, kept by what is in it: compiling takes longer than all else."""
    with open(source, "rb") as file:
        name = hashlib.sha256(file.read() + " ".join(COMPILER).encode()).hexdigest()[:20]
    library = os.path.join(folder, name + ".so")
    if not os.path.exists(library):
        subprocess.run([*COMPILER, "-o", library + ".part", source, "-lm"], check=True)
        os.replace(library + ".part", library)
    return library


COMPILER = ["cc", "-O2", "-march=native", "-fPIC", "-shared"]
SQP = {"print_header": False, "print_iteration": False, "print_status": False, "tol_pr": 1e-6, "tol_du": 1e-6, "max_iter": 100}
QPOASES = {"printLevel": "none", "error_on_fail": False}
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-8,
    "warm_start_bound_frac": 1e-8,
    "warm_start_slack_bound_push": 1e-8,
    "warm_start_slack_bound_frac": 1e-8,
    "warm_start_mult_bound_push": 1e-8,
    "bound_relax_factor": 0.0,
}


def sqp(qpsol, options):
    return {**SQP, "qpsol": qpsol, "qpsol_options": {"error_on_fail": False, **options}}


def rows():
    """Every CasADi row; the first is what the ratios are to. Not OSQP: it diverges where the exact Hessian is indefinite."""
    quiet = {"print_iter": False, "print_header": False, "print_info": False}
    fatrop = {"print_level": 0, "tol": 1e-8, "warm_start_init_point": True, "mu_init": 1e-6}
    return [
        Row("CasADi sqpmethod + qpOASES", "sqpmethod", "multiple", sqp("qpoases", QPOASES)),
        Row("CasADi sqpmethod + qpOASES, single shooting", "sqpmethod", "single", sqp("qpoases", QPOASES)),
        Row("CasADi sqpmethod + qrqp", "sqpmethod", "multiple", sqp("qrqp", quiet)),
        Row("CasADi sqpmethod + DAQP, single shooting", "sqpmethod", "single", sqp("daqp", {})),
        Row("CasADi sqpmethod + HPIPM", "sqpmethod", "tailed", sqp("hpipm", {})),
        Row("CasADi fatrop", "fatrop", "tailed", {"structure_detection": "auto", "fatrop": fatrop}),
        Row("CasADi ipopt (MUMPS)", "ipopt", "multiple", {"ipopt": {**IPOPT, "tol": 1e-8, "mu_init": 1e-6}}),
    ]


def tight():
    """What the inputs are compared with, if its residuals are the smaller ones: ipopt to 1e-12."""
    return Row("ipopt to 1e-12", "ipopt", "multiple", {"ipopt": {**IPOPT, "tol": 1e-12, "mu_init": 1e-6, "constr_viol_tol": 1e-13, "dual_inf_tol": 1e-12, "compl_inf_tol": 1e-13, "acceptable_iter": 0}})

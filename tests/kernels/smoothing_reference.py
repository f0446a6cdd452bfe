"""Smoothing written plainly from its equations: lists, sets and loops over vertices."""

from __future__ import annotations

from collections import defaultdict

import numpy as np


def proper(faces):
    return [tuple(face) for face in np.asarray(faces).tolist() if len(set(face)) == 3]


def neighbours_of(n_vertices, faces):
    found = [set() for _ in range(n_vertices)]
    for face in proper(faces):
        for vertex in face:
            found[vertex] |= set(face) - {vertex}
    return found


def boundary_of(n_vertices, faces):
    uses = defaultdict(int)
    for a, b, c in proper(faces):
        for edge in ((a, b), (b, c), (c, a)):
            uses[frozenset(edge)] += 1
    mask = np.zeros(n_vertices, bool)
    for edge, count in uses.items():
        if count == 1:
            mask[list(edge)] = True
    return mask


def area(a, b, c):
    return np.linalg.norm(np.cross(b - a, c - a)) / 2


def circumcentre(a, b, c):
    """By its barycentric coordinates a^2 (b^2 + c^2 - a^2), a being the edge opposite to the first corner."""
    aa, bb, cc = np.sum((b - c) ** 2), np.sum((c - a) ** 2), np.sum((a - b) ** 2)
    weights = np.array([aa * (bb + cc - aa), bb * (cc + aa - bb), cc * (aa + bb - cc)])
    return weights @ np.array([a, b, c]) / weights.sum()


def goal(method, points, vertex, neighbours, faces):
    """p* of equations 2.12 to 2.15, or None where it is not defined."""
    around = sorted(neighbours[vertex])
    if not around:
        return None
    if method == "standard":
        return np.mean(points[around], axis=0)
    if method == "lumped":
        return points[vertex] / 3 + 2 / 3 * np.mean(points[around], axis=0)
    centres, weights = [], []
    for face in faces:
        corners = points[list(face)]
        size = area(*corners)
        if method.startswith("wcc"):
            if size == 0:
                continue
            centres.append(circumcentre(*corners))
        else:
            centres.append(np.mean(corners, axis=0))
        weights.append(1.0 if method.endswith("equal") else size)
    return np.average(centres, axis=0, weights=weights) if sum(weights) > 0 else None


def normals_of(points, faces):
    normals = np.zeros_like(points)
    for a, b, c in proper(faces):
        for vertex in (a, b, c):
            normals[vertex] += np.cross(points[b] - points[a], points[c] - points[a])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)


def one_pass(points, faces, free, method, update, factor, normals):
    old, new = points, points.copy()
    neighbours = neighbours_of(len(points), faces)
    attached = [[face for face in proper(faces) if vertex in face] for vertex in range(len(points))]
    for vertex in free:
        seen = new if update == "sequential" else old
        target = goal(method, seen, vertex, neighbours, attached[vertex])
        if target is None:
            continue
        move = factor * (target - seen[vertex])
        new[vertex] = seen[vertex] + projected(move, normals, vertex)
    return new


def projected(move, normals, vertex):
    if normals is None:
        return move
    normal = normals[vertex]
    if not normal.any():
        return np.zeros(3)
    return move - np.dot(move, normal) * normal


def volume(points, faces):
    corners = points[np.asarray(faces)]
    return np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6


def offset_to_volume(points, faces, free, target):
    """Offset by the real root nearest to 0 of the volume, a cubic polynomial in the distance."""
    normals = normals_of(points, faces)
    normals[[vertex for vertex in range(len(points)) if vertex not in set(free)]] = 0
    corners, directions = points[np.asarray(faces)], normals[np.asarray(faces)]
    coefficients = np.zeros(4)
    for xyz, ways in zip(corners, directions, strict=True):
        for power in range(8):
            bits = [power >> k & 1 for k in range(3)]
            rows = [ways[k] if bits[k] else xyz[k] for k in range(3)]
            coefficients[sum(bits)] += np.linalg.det(rows) / 6
    coefficients[0] -= target
    roots = np.roots(coefficients[::-1])
    real = roots[abs(roots.imag) < 1e-9].real
    distance = real[abs(real).argmin()]
    for _ in range(3):  # np.roots finds it to some 1e-12 only
        distance -= np.polyval(coefficients[::-1], distance) / np.polyval(np.polyder(coefficients[::-1]), distance)
    return points + distance * normals


def smooth(points, faces, iterations, fixed=None, **settings):
    """What `smooth_vertices` computes; of a single component if the volume is kept."""
    method, update = settings.get("method", "standard"), settings.get("update", "simultaneous")
    correction = settings.get("correction", "none")
    factor = settings.get("step", 0.5 if correction == "taubin" else 1.0)
    alpha, beta = settings.get("alpha", 0.0), settings.get("beta", 0.5)
    tangential = settings.get("tangential", False)
    stays = boundary_of(len(points), faces)
    if fixed is not None:
        stays |= fixed
    free = [vertex for vertex in range(len(points)) if not stays[vertex]]
    neighbours = neighbours_of(len(points), faces)
    original = points
    for _ in range(iterations):
        before = points
        normals = normals_of(points, faces) if tangential else None
        points = one_pass(points, faces, free, method, update, factor, normals)
        if correction == "taubin":
            normals = normals_of(points, faces) if tangential else None
            points = one_pass(points, faces, free, method, update, settings["taubin_mu"], normals)
        elif correction == "hc":
            b = points - (alpha * original + (1 - alpha) * before)
            b[stays] = 0
            pushed = points.copy()
            for vertex in free:
                if neighbours[vertex]:
                    back = beta * b[vertex] + (1 - beta) * np.mean(b[sorted(neighbours[vertex])], axis=0)
                    pushed[vertex] = points[vertex] - projected(back, normals, vertex)
            points = pushed
        elif correction == "volume":
            points = offset_to_volume(points, faces, free, volume(original, faces))
    return points

"""The feature tracker: converts images of the ceiling to observations of features.

Every feature is matched to its patch of FIRST detection, never to the last image, so that errors do not
accumulate along a track. The patch is rotated by the predicted rotation of the camera since then. The
error of this prediction is estimated together with the positions (`patches.align`), so that an error of
the gyro does not become an error of the tracks.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.config.sections import TrackerConfig
from gyrocal_ros.data import (
    Array,
    CameraIntrinsics,
    FeatureObservations,
    Frame,
    IntArray,
    SearchRegions,
    nanoseconds,
)
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.model.camera import in_image
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.vision.corners import find_corners, noise_level, recognisable
from gyrocal_ros.vision.defective_pixels import DefectivePixels
from gyrocal_ros.vision.features import Features, Match, SearchSet
from gyrocal_ros.vision.image_flow import followed
from gyrocal_ros.vision.lens_marks import (
    MIN_CHANGES,
    MOVED_PX,
    STAYED_PX,
    LensMarks,
    ViewChange,
    correlation_at,
)
from gyrocal_ros.vision.patches import MATCHING_PX, NODE_CENTRE, align, extract_patches, node_offsets
from gyrocal_ros.vision.search_region import (
    approximate_ceiling,
    best_match,
    ceiling_coordinates,
    ceiling_pixels,
    in_region,
    region_radius,
)

UNPREDICTED_STD_PX = 5.0
"""Standard deviation of the position of a feature without a region: about the motion between two images."""
MAX_RADIUS_PX = 20
"""Radius above which a region from the filter is not used."""
MAX_WARP_SHIFT_PX = 2.0
"""Distance from the predicted position above which a patch is warped again for the lens there and
realigned."""
UNUSED_S = 1.0
"""Time without a place in the map from which a feature is not used by the filter, and takes no place of
another."""
MAX_UNUSED_SHARE = 0.5
"""Largest number of such features that are replaced, as a share of those wanted."""
MAX_NOISE_PX = 0.1
"""Limit of the position noise of a new corner, as far as it is caused by the image noise."""


AS_COMPLEX = np.array([1.0, 1.0j])
"""Factor that turns coordinates (n, 2) into complex numbers (n,)."""
ID_COUNT = 2**32
"""Number of ids; they are 32 bits wide in messages."""


class Tracker:
    """Tracks features from image to image.

    Args:
        camera: intrinsics of the images.
        config: numbers, distances and thresholds.
        first_id: id of the first feature; later ids count up from it.
    """

    def __init__(self, camera: CameraIntrinsics, config: TrackerConfig, first_id: int = 0) -> None:
        self._camera = camera
        self.config = config
        """Settings; they may be replaced between images, except the sizes of patch and border."""
        self._size_px = config.patch_px | 1
        self._margin_px = max(config.border_px, math.ceil(self._size_px / math.sqrt(2.0)) + 2)
        self._next_id = first_id
        self._last_ns = -1
        self._frames_to_detection = 0
        self._yaw_error_rad = self._yaw_error_std_rad = 0.0  # see `yaw_error_rad`
        self._view, self._marks = ViewChange(), LensMarks()
        self._defects = DefectivePixels(camera.height_px, camera.width_px)
        self._last: tuple[Frame, FeatureObservations] | None = None
        self._found_by_flow = False
        dark = np.zeros((camera.height_px, camera.width_px), np.uint8)
        self._features = self._new_features(Frame(0, dark), np.eye(3), np.zeros((0, 2), np.intp))

    @property
    def yaw_error_rad(self) -> float:
        """Yaw of the given attitudes minus the yaw of the images, since the first image."""
        return self._yaw_error_rad

    @property
    def yaw_error_std_rad(self) -> float:
        """Standard deviation of `yaw_error_rad`: patches almost without texture hardly show a rotation."""
        return self._yaw_error_std_rad

    @property
    def found_by_flow(self) -> bool:
        """True if the predictions for the last image were so wrong that only its flow led to the features."""
        return self._found_by_flow

    def track(self, frame: Frame, R_wc: Array, regions: SearchRegions | None) -> FeatureObservations:
        """Find the known features in an image, and new ones if there are too few.

        Args:
            frame: the next image.
            R_wc: (3, 3) predicted attitude, from the optical frame to the world. Its yaw may have a
                slowly varying error.
            regions: search regions of the features that the filter knows.

        Raises:
            RecordingError: the size of the image differs from that of the camera.
        """
        self._check(frame)
        self._defects.learn(frame.image, math.atan2(R_wc[1, 0], R_wc[0, 0]))
        frame = replace(frame, image=self._defects.corrected(frame.image))
        self._drop_old(frame.t_ns)
        self._note_used(frame.t_ns, regions)
        search = self._select(R_wc, regions)
        match = self._match(frame.image, R_wc, search)
        self._view.add(frame.image)
        on_lens = self._reject_on_lens(frame, search, match)
        pixels, found = match.pixels, match.score > 0.0
        seen = search.index[found]
        self._features.seen_ns[seen] = frame.t_ns
        moved_px = np.linalg.norm(pixels[found] - self._features.first_pixels[seen], axis=1)
        self._features.first_view[seen[moved_px > MOVED_PX]] = self._view.number
        self._features.ceiling[seen] = self._to_ceiling(pixels[found], R_wc)
        new = self._detect(frame, R_wc, pixels, seen)
        self._last_ns = frame.t_ns
        ids = np.concatenate([self._features.ids[seen], self._features.ids[len(self._features) - len(new) :]])
        first = np.broadcast_to(MATCHING_PX**2 * np.eye(2), (len(new), 2, 2))
        covariances = np.concatenate([match.covariances_px2[found], first])
        if len(on_lens):
            self._features = self._features[~np.isin(np.arange(len(self._features)), on_lens)]
        pixels = np.concatenate([pixels[found], new])
        observed = FeatureObservations(frame.t_ns, ids, pixels, covariances, len(on_lens))
        self._last = frame, observed
        return observed

    def _check(self, frame: Frame) -> None:
        expected = (self._camera.height_px, self._camera.width_px)
        if frame.image.shape != expected:
            got = ' x '.join(str(side) for side in frame.image.shape[1::-1])
            raise RecordingError(
                f'an image is {got} pixels, but its camera info says {expected[1]} x {expected[0]}',
                todo='record images and camera info at the same resolution',
            )

    def _drop_old(self, t_ns: int) -> None:
        """Drop the features that have not been found for longer than `reacquire_s`."""
        lost = self._features.seen_ns != self._last_ns
        old = np.abs(t_ns - self._features.seen_ns) > nanoseconds(self.config.reacquire_s)
        if (lost & old).any():
            self._features = self._features[~(lost & old)]

    def _note_used(self, t_ns: int, regions: SearchRegions | None) -> None:
        """Note which features the filter has in its map."""
        in_map = slice(None) if regions is None else np.isin(self._features.ids, regions.ids)
        self._features.used_ns[in_map] = t_ns

    def _wanted(self, indices: IntArray) -> int:
        """Return the number of features to track, of which these are found: unused ones are replaced.

        They are tracked further, so that no new feature is found in their place.
        """
        unused_ns = self._features.seen_ns[indices] - self._features.used_ns[indices]
        unused = int(np.count_nonzero(unused_ns > nanoseconds(UNUSED_S)))
        return self.config.features + min(unused, int(MAX_UNUSED_SHARE * self.config.features))

    def _attitude(self, R_wc: Array) -> Array:
        """Return the attitude with the yaw corrected by that of the patches."""
        return rotation_from_euler(np.array([0.0, 0.0, -self._yaw_error_rad])) @ R_wc

    def _to_ceiling(self, pixels: Array, R_wc: Array) -> Array:
        return approximate_ceiling(self._camera, pixels, self._attitude(R_wc))

    def _to_pixels(self, ceiling: Array, R_wc: Array) -> Array:
        return ceiling_pixels(self._camera, ceiling, self._attitude(R_wc))

    def _select(self, R_wc: Array, regions: SearchRegions | None) -> SearchSet:
        """Select the features to search for, and their regions.

        Lost features are searched for only while fewer features than wanted are tracked, and only if
        the filter predicts them.
        """
        features = self._features
        pixels = self._to_pixels(features.ceiling, R_wc)
        covariances = np.tile(UNPREDICTED_STD_PX**2 * np.eye(2), (len(features), 1, 1))
        tracked = features.seen_ns == self._last_ns
        reacquired = np.zeros(len(features), dtype=bool)
        if regions is not None:
            _, ours, theirs = np.intersect1d(features.ids, regions.ids, return_indices=True)
            usable = region_radius(regions.covariances_px2[theirs]) <= MAX_RADIUS_PX
            ours, theirs = ours[usable], theirs[usable]
            pixels[ours] = regions.pixels[theirs]
            covariances[ours] = regions.covariances_px2[theirs]
            reacquired[ours] = tracked.sum() < self._wanted(tracked.nonzero()[0])
        index = np.flatnonzero((tracked | reacquired) & in_image(self._camera, pixels, self._margin_px))
        return SearchSet(index, pixels[index], covariances[index], tracked[index])

    def _match(self, image: NDArray[np.uint8], R_wc: Array, search: SearchSet) -> Match:
        """Search for features; the pixels are as predicted where one is not found."""
        self._found_by_flow = False
        if not len(search.index):
            return Match(search.pixels, search.covariances_px2, np.empty(0))
        match = self._align(image, R_wc, search, search.pixels)
        if 2 * (search.tracked & (match.score > 0.0)).sum() < search.tracked.sum():
            search, match = self._by_flow(image, R_wc, search, match)
        match = self._by_correlation(image, R_wc, search, match)
        score = match.score
        _reject_duplicates(match.pixels, score, 0.5 * self.config.patch_px)
        found = search.index[search.tracked & (score > 0.0)]
        vacant = max(0, self._wanted(found) - len(found))
        reacquired = np.flatnonzero(~search.tracked & (score > 0.0))
        score[reacquired[np.argsort(-score[reacquired], kind='stable')][vacant:]] = -1.0
        match.pixels[score < 0.0] = search.pixels[score < 0.0]
        return match

    def _by_correlation(
        self, image: NDArray[np.uint8], R_wc: Array, search: SearchSet, match: Match
    ) -> Match:
        """Search again for what was missed, in larger regions if that is most."""
        searched = search.tracked if search.tracked.any() else np.ones(len(match.score), dtype=bool)
        missed = searched & (match.score < 0.0)
        if missed.any():
            again = search[missed]
            if 2 * len(again.index) > search.tracked.sum():
                again.covariances_px2[:] += UNPREDICTED_STD_PX**2 * np.eye(2)
            match[missed] = self._align(image, R_wc, again, self._best_matches(image, R_wc, again))
        return match

    def _by_flow(
        self, image: NDArray[np.uint8], R_wc: Array, search: SearchSet, match: Match
    ) -> tuple[SearchSet, Match]:
        """Search where the flow of the image leads; keep the matches if most features are found there.

        The flow shows the error of the predicted yaw and the motion over the ceiling of all features.
        """
        assert self._last is not None
        (last, seen), features = self._last, self._features[search.index]
        _, rows, places = np.intersect1d(features.ids, seen.ids, return_indices=True)
        pixels, agreeing = followed(last.image, image, seen.pixels[places])
        if not agreeing.any():
            return search, match
        yaw_error_rad, yaw_error_std_rad = self._yaw_error_rad, self._yaw_error_std_rad
        before = features.ceiling[rows[agreeing]] @ AS_COMPLEX
        after = self._to_ceiling(pixels[agreeing], R_wc) @ AS_COMPLEX
        self._yaw_error_rad += float(np.angle(np.vdot(before - before.mean(), after - after.mean())))
        moved = self._to_ceiling(pixels[agreeing], R_wc) - features.ceiling[rows[agreeing]]
        predicted = self._to_pixels(features.ceiling + np.median(moved, axis=0), R_wc)
        covariances = np.tile(UNPREDICTED_STD_PX**2 * np.eye(2), (len(predicted), 1, 1))
        by_flow = SearchSet(search.index, predicted, covariances, search.tracked)
        found = self._align(image, R_wc, by_flow, predicted)
        if 2 * (found.score > 0.0).sum() > search.tracked.sum():
            self._found_by_flow = True
            return by_flow, found
        self._yaw_error_rad, self._yaw_error_std_rad = yaw_error_rad, yaw_error_std_rad
        return search, match

    def _reject_on_lens(self, frame: Frame, search: SearchSet, match: Match) -> IntArray:
        """Reject the matches of features that stay in the image; return the indices of these features."""
        features = self._features
        moved_px = np.linalg.norm(match.pixels - features.first_pixels[search.index], axis=1)
        has_stayed = (moved_px < STAYED_PX) | (match.score < 0.0)
        changes = self._view.number - features.first_view[search.index]
        suspects = np.flatnonzero((changes >= MIN_CHANGES) & has_stayed & search.tracked)
        if not len(suspects):
            return suspects
        first = features[search.index[suspects]]
        correlation = correlation_at(frame.image, first.patches, first.first_pixels)
        on_lens = suspects[correlation > self.config.min_correlation]
        match.score[on_lens] = -1.0
        self._marks.add(features.first_pixels[search.index[on_lens]], frame.t_ns)
        return search.index[on_lens]

    def _best_matches(self, image: NDArray[np.uint8], R_wc: Array, search: SearchSet) -> Array:
        """Return the positions (k, 2) of best correlation in the regions, to the pixel."""
        features = self._features[search.index]
        nodes = self._nodes(features, search.pixels, R_wc)
        arguments = zip(features.patches.template, nodes, search.covariances_px2, strict=True)
        return search.pixels + np.array([best_match(image, *each) for each in arguments])

    def _align(self, image: NDArray[np.uint8], R_wc: Array, search: SearchSet, starts: Array) -> Match:
        """Align the patches by Lucas-Kanade."""
        features = self._features[search.index]
        for _ in range(2):
            nodes = self._nodes(features, starts, R_wc)
            result = align(image, features.patches, nodes, self.config.min_correlation)
            good = (
                (result.correlation > max(0.0, self.config.min_correlation))
                & (result.backward_px <= self.config.max_reprojection_px)
                & in_region(result.pixels - search.pixels, search.covariances_px2)
                & in_image(self._camera, result.pixels, self._margin_px)
            )
            if good.any():
                self._yaw_error_rad += result.twist_rad
                self._yaw_error_std_rad = result.twist_std_rad
            moved_px = np.linalg.norm(result.pixels - starts, axis=1)
            if not (moved_px[good] > MAX_WARP_SHIFT_PX).any():
                break
            starts = np.where(good[:, None], result.pixels, starts)
        return Match(result.pixels, result.covariances_px2, np.where(good, result.correlation, -1.0))

    def _nodes(self, features: Features, centres: Array, R_wc: Array) -> Array:
        """Return pixels (n, 9, 2) of the nodes of patches whose centres are at pixels (n, 2)."""
        return self._to_pixels(self._to_ceiling(centres, R_wc)[:, None] + features.outline, R_wc)

    def _detect(self, frame: Frame, R_wc: Array, taken: Array, seen: IntArray) -> Array:
        """Add new features if detection is due or many are missing; return their pixels (k, 2)."""
        missing = self._wanted(seen) - len(seen)
        self._frames_to_detection -= 1
        if missing <= 0 or (self._frames_to_detection > 0 and missing <= len(seen)):
            return np.zeros((0, 2))
        self._frames_to_detection = self.config.detect_interval
        corners = find_corners(frame.image, taken, self._marks.pixels, self._margin_px, self.config)
        information = extract_patches(frame.image, corners, self._size_px).information
        precise = information * MAX_NOISE_PX**2 > noise_level(frame.image) ** 2
        limit = max(0.0, self.config.min_correlation)
        usable = recognisable(frame.image, corners[precise], self._size_px, limit)
        corners = np.array(list(islice(usable, missing)), dtype=np.intp).reshape(-1, 2)
        self._features += self._new_features(frame, R_wc, corners)
        self._next_id += len(corners)
        return corners.astype(float)

    def _new_features(self, frame: Frame, R_wc: Array, corners: NDArray[np.intp]) -> Features:
        nodes = corners[:, None] + node_offsets(self._size_px)
        outline = ceiling_coordinates(self._camera, nodes, self._attitude(R_wc))
        ceiling = outline[:, NODE_CENTRE]
        ids = (self._next_id + np.arange(len(corners))) % ID_COUNT
        patches = extract_patches(frame.image, corners, self._size_px)
        now_ns, view = np.full(len(ids), frame.t_ns), np.full(len(ids), self._view.number)
        relative = outline - ceiling[:, None]
        return Features(ids, now_ns, now_ns.copy(), ceiling, relative, corners, view, patches)


def _reject_duplicates(pixels: Array, score: Array, distance_px: float) -> None:
    """Reject the match with the lower score of any two matches closer than a distance."""
    close = np.linalg.norm(pixels[:, None] - pixels, axis=2) < distance_px
    for k in np.flatnonzero(close.sum(axis=1) > 1):
        rivals = close[k] & (score > 0.0)
        if rivals[k] and score[k] < score[rivals].max():
            score[k] = -1.0

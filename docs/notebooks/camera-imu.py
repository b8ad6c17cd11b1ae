# %% [markdown]
# # A camera and an IMU
#
# A rig is waved before a board for half a minute. One estimation gives where the camera sits on the IMU, the shift of
# their clocks, the scales, the axes and the biases. A simulated rig stands for yours: with a bag,
# `gnomon.read_camera_imu("rig.bag", target="board.yaml")` gives the same two values.

# %%
import gnomon

simulated = gnomon.simulate_camera_imu(gnomon.CameraImuScenario(duration_s=30.0), seed=3)
recording, target = simulated.recording, simulated.target

# %%
result = gnomon.calibrate_camera_imu(recording, target)
result

# %% [markdown]
# The pose of the camera and the time shift, as other programs want them.

# %%
camera = result.calibration.cameras["cam0"]
print(camera.T_cam_imu)
print(camera.time_shift_cam_imu, "s")

# %% [markdown]
# Where the corners were, what is left of them, and the biases over time.

# %%
figure = result.plot("density")

# %%
figure = result.plot("biases")

# %% [markdown]
# The truth of this rig is known: is it within the stated standard deviations?

# %%
print(gnomon.compare(result, simulated.truth, names=["estimate", "truth"]).headline)

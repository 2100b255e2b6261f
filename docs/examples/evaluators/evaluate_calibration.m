% Evaluates a calibration document (docs/model.md) in Octave 7 or MATLAB.
%   document = jsondecode(fileread('calibration.json'));
%   pixel = evaluate_calibration(document, 'project', [east; north; up])     x; y in px
%   direction = evaluate_calibration(document, 'back-project', [x; y])       east; north; up (closed form)
%   sigmas = evaluate_calibration(document, 'holding', [x; y; 0.95])         within which a share of the errors lies
function result = evaluate_calibration(document, what, given)
  m = document.model; image = document.image; c = m.principal_point_px; f = m.focal_length_px;
  R = rotation(m.rotation_cam_enu(:));
  if strcmp(what, 'project')
    ray = R * given(:) + m.translation(:);
    across = hypot(ray(1), ray(2)); theta = atan2(across, ray(3));
    result = [NaN; NaN];
    if theta > m.max_angle_deg * pi / 180, return, end
    r = ideal(m.projection, theta, false) + sum(m.radial(:)' .* (theta / (pi / 2)) .^ (2:9));
    point = [0; 0];
    if across > 0, point = r * ray(1:2) / across; end
    point = point + shift(m.decentering, r, point);
    result = [f(1) * point(1) + m.skew_px * point(2) + c(1); f(2) * point(2) + c(2)];
    if image.mirrored, result(1) = image.width - 1 - result(1); end
    result = displaced(document.uncertainty.field, result);
  elseif strcmp(what, 'holding')
    result = holding(document.uncertainty, given(:)');
  else
    seen = given(:); given = seen;
    for k = 1:8, given = seen - (displaced(document.uncertainty.field, given) - given); end
    if image.mirrored, given(1) = image.width - 1 - given(1); end
    b = document.backward_model;
    y = (given(2) - c(2)) / f(2); x = (given(1) - c(1) - m.skew_px * y) / f(1);
    r = hypot(x, y);
    point = [x; y] - shift(b.decentering, r, [x; y]);
    adjusted = max(norm(point), realmin);
    theta = ideal(m.projection, adjusted - sum(b.radial(:)' .* r .^ (2:9)), true);
    result = R' * [sin(theta) * point / adjusted; cos(theta)];
  end
end

function sigmas = holding(uncertainty, given)
  w = 1; s = 1; t = 0;
  if isfield(uncertainty, 'mixture') && ~isempty(uncertainty.mixture)
    m = uncertainty.mixture; w = m.shares(:)'; at = reshape(m.pixels_px, [], 2);
    near = (1 + sum((at - given(1:2)) .^ 2, 2)) .^ -2;
    s = near' * reshape(m.scales, [], numel(w)) / sum(near);
  end
  for k = 1:60  % Newton's method; what is outside falls with t and is convex
    outside = w .* exp(-t ./ (2 * s .^ 2));
    t = t + sum(outside) * log(sum(outside) / (1 - given(3))) / sum(outside ./ (2 * s .^ 2));
  end
  sigmas = sqrt(t);
end

function pixel = displaced(field, pixel)  % by the field's mean
  if isempty(field.orders), return, end
  h = field.half_px(:); place = (pixel - field.center_px(:)) ./ h + 1;
  if any(place <= 0 | place >= 2), return, end
  n = reshape(field.orders, [], 2); mean = reshape(field.mean, 2, []);
  pixel = pixel + mean * (sin(pi / 2 * n(:, 1) * place(1)) .* sin(pi / 2 * n(:, 2) * place(2))) / sqrt(prod(h));
end

function R = rotation(w)  % of a rotation vector (Rodrigues)
  angle = norm(w); a = w / max(angle, realmin);
  K = [0, -a(3), a(2); a(3), 0, -a(1); -a(2), a(1), 0];
  R = eye(3) + sin(angle) * K + (1 - cos(angle)) * K * K;
end

function d = shift(c, r, point)  % decentering, p1 ... p4 or q1 ... q5
  u = 1; v = 0;
  if r > 0, u = point(1) / r; v = point(2) / r; end
  c = c(:)'; g = r ^ 2 * (1 + sum(c(3:end) .* r .^ (2 * (1:numel(c) - 2))));
  d = g * [c(1) * (1 + 2 * u ^ 2) + 2 * c(2) * u * v; 2 * c(1) * u * v + c(2) * (1 + 2 * v ^ 2)];
end

function y = ideal(projection, x, inverse)  % radius of an angle, or angle of a radius
  forward = {@(t) tan(t), @(t) t, @(t) 2 * sin(t / 2), @(t) 2 * tan(t / 2), @(t) sin(t)};
  backward = {@(r) atan(r), @(r) r, @(r) 2 * asin(r / 2), @(r) 2 * atan(r / 2), @(r) asin(r)};
  names = {'perspective', 'equidistant', 'equisolid', 'stereographic', 'orthographic'};
  if inverse, functions = backward; else, functions = forward; end
  y = functions{strcmp(names, projection)}(x);
end
